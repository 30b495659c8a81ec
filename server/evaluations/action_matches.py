"""Which of a team's models gives a log's actions? Answered from the stored episodes, so without another run.

A model and the log were played from the same fixed starts. As long as their actions in an episode are equal, both saw
the same observations to the last bit; the first other action says that this model did not choose the log's. `vitac log
match` goes further: it shows the model the log's states also after that.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial
from uuid import UUID

from sqlalchemy import Select, bindparam, or_, select
from sqlalchemy.orm import Session, defer, joinedload
from vitac.evaluator.episodes.records import ActionSequence
from vitac.evaluator.logs.comparison import EpisodeMatch, compare_actions
from vitac.evaluator.submission_kinds import POLICY_KINDS

from ..cache import Cache
from ..database.models import EpisodeResult, Evaluation, Submission
from ..database.states import EvaluationState
from ..principals import Principal
from ..views.receipts import ActionMatchView, MatchedEpisodeView
from ..visibility import decide_sight, visible
from .episode_store import EpisodeKey
from .history import newest_evaluation

MAX_MODELS = 20
"""Number of models that are compared, the ones evaluated last."""


ActionsByEpisode = dict[int, ActionSequence]

_matches: Cache[tuple[UUID, UUID], ActionMatchView] = Cache(at_most=2000)
"""Matches by the evaluations of log and model. They never change: a completed evaluation has all its episodes."""


def action_matches(session: Session, by: Principal, submission_id: UUID) -> list[ActionMatchView]:
    """Return how the team's models of the same evaluator and episode list compare with a verified log, newest first.

    Raises:
        ServiceError: there is no such submission.
    """
    return read_matches(session, by, newest_evaluation(session, visible(session, by, submission_id)))


def read_matches(session: Session, by: Principal, evaluation: Evaluation) -> list[ActionMatchView]:
    """Return the same by the newest evaluation of the log; nothing where its episodes are not shown."""
    log = evaluation.submission
    if not log.kind.form.is_verified or evaluation.state is not EvaluationState.COMPLETED:
        return []
    if not decide_sight(by, evaluation).episodes:
        return []
    from_log = cache(lambda: _actions(session, EpisodeKey.from_evaluation(evaluation, log), log.tasks[0]))
    return [
        _matches.get((evaluation.id, model), partial(_compared, session, model, log.tasks[0], from_log))
        for model in _models(session, log, evaluation)
    ]


def _compared(session: Session, model_id: UUID, task: str, from_log: Callable[[], ActionsByEpisode]) -> ActionMatchView:
    model = session.get_one(
        Evaluation, model_id, options=[defer(Evaluation.log_tail), joinedload(Evaluation.submission)]
    )
    # A log plays the public list, and so did each model, where another list ranks beside it.
    key = EpisodeKey.from_evaluation(model, model.submission).select_public_list()
    return _compare(model, from_log(), _actions(session, key, task))


def _models(session: Session, log: Submission, evaluation: Evaluation) -> Sequence[UUID]:
    asked = {
        "team": log.team_id,
        "track": log.track,
        "tasks": log.tasks,
        "evaluator_version": evaluation.evaluator_version,
    }
    return session.scalars(_last_models(), asked).all()


@cache
def _last_models() -> Select[UUID]:
    """Return the query of a team's models, put together once: each page of a log asks it."""
    return (
        select(Evaluation.id)
        .join(Submission)
        .where(
            Submission.team_id == bindparam("team"),
            Submission.track == bindparam("track"),
            Submission.kind.in_(POLICY_KINDS),
            Submission.tasks.contains(bindparam("tasks")),
            Evaluation.evaluator_version == bindparam("evaluator_version"),
            or_(Evaluation.commitment.is_(None), Evaluation.practice_scores.is_not(None)),
            Evaluation.state == EvaluationState.COMPLETED,
        )
        .order_by(Evaluation.finished_at.desc(), Evaluation.id)
        .limit(MAX_MODELS)
    )


def _actions(session: Session, key: EpisodeKey, task: str) -> ActionsByEpisode:
    rows = session.execute(
        select(EpisodeResult.episode, EpisodeResult.record["actions"])
        .where(*key.conditions(), EpisodeResult.task == task)
        .order_by(EpisodeResult.episode)
    )
    return {episode: ActionSequence.model_validate(actions) for episode, actions in rows}


def _compare(model: Evaluation, from_log: ActionsByEpisode, of_model: ActionsByEpisode) -> ActionMatchView:
    match = compare_actions(from_log, of_model)
    return ActionMatchView(
        submission_id=model.submission_id,
        submission_name=model.submission.name,
        evaluated_at=model.finished_at or model.created_at,
        actions=match.actions,
        reproduced=match.reproduced,
        episodes=len(match.episodes),
        episodes_reproduced=sum(episode.first_mismatch is None for episode in match.episodes),
        others=[_episode(episode) for episode in match.episodes if episode.first_mismatch is not None],
    )


def _episode(episode: EpisodeMatch) -> MatchedEpisodeView:
    return MatchedEpisodeView(**episode.model_dump(exclude={"failure"}))
