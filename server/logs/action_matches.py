"""Which of a team's models gives a log's actions? Answered from the stored episodes, so without another run.

A model and the log were played from the same fixed starts. As long as their actions in an episode are equal, both saw
the same observations to the last bit; the first other action says that this model did not choose the log's. `vitac log
match` goes further: it shows the model the log's states also after that.
"""

from collections import OrderedDict
from collections.abc import Iterable, Sequence
from threading import Lock
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session, defer, joinedload
from vitac.evaluator.episodes.records import ActionSequence
from vitac.evaluator.logs.action_match import EpisodeMatch, compare_actions
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.accounts.principals import Principal
from vitac.server.accounts.visibility import visible
from vitac.server.db.models import EpisodeResult, Evaluation, Submission
from vitac.server.db.states import EvaluationState
from vitac.server.evaluations.episode_store import EpisodeKey
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.views.logs import ActionMatchView, MatchedEpisodeView

MAX_MODELS = 20
"""So many models are compared, the ones evaluated last."""


MAX_KEPT = 2000
"""So many matches are kept by this process; reading the actions of two evaluations takes many milliseconds."""

ActionsByEpisode = dict[int, ActionSequence]
Pair = tuple[UUID, UUID]
"""Evaluations of a log and of a model."""


def action_matches(session: Session, by: Principal, submission_id: UUID) -> list[ActionMatchView]:
    """Return how the team's models of the same evaluator compare with a verified log, newest first.

    Raises:
        ServiceError: there is no such submission.
    """
    log = visible(session, by, submission_id)
    evaluation = newest_evaluation(session, log)
    if not log.kind.form.is_verified or evaluation.state is not EvaluationState.COMPLETED:
        return []
    models = _models(session, log, evaluation.evaluator_version)
    known = _known.get_all((evaluation.id, model) for model in models)
    if len(known) < len(models):
        new = [model for model in models if (evaluation.id, model) not in known]
        known |= _known.keep_all(_compared(session, log, evaluation, new))
    return [known[evaluation.id, model] for model in models]


class _KnownMatches:
    """The matches that were asked for last. They do not change: a completed evaluation has all its episodes."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._kept: OrderedDict[Pair, ActionMatchView] = OrderedDict()

    def get_all(self, pairs: Iterable[Pair]) -> dict[Pair, ActionMatchView]:
        """Return those that are kept."""
        with self._lock:
            found = {pair: self._kept[pair] for pair in pairs if pair in self._kept}
            for pair in found:
                self._kept.move_to_end(pair)
            return found

    def keep_all(self, matches: dict[Pair, ActionMatchView]) -> dict[Pair, ActionMatchView]:
        """Return what is kept from now on; what was not asked for longest is dropped."""
        with self._lock:
            self._kept |= matches
            while len(self._kept) > MAX_KEPT:
                self._kept.popitem(last=False)
        return matches


_known = _KnownMatches()


def _compared(
    session: Session, log: Submission, evaluation: Evaluation, models: Sequence[UUID]
) -> dict[Pair, ActionMatchView]:
    task = log.tasks[0]
    of_log = _actions(session, EpisodeKey.of(evaluation, log), task)
    loaded = session.scalars(
        select(Evaluation)
        .where(Evaluation.id.in_(models))
        .options(defer(Evaluation.log_tail), joinedload(Evaluation.submission))
    )
    return {
        (evaluation.id, model.id): _compare(
            model, of_log, _actions(session, EpisodeKey.of(model, model.submission), task)
        )
        for model in loaded
    }


def _models(session: Session, log: Submission, version: str) -> Sequence[UUID]:
    return session.scalars(
        select(Evaluation.id)
        .join(Submission)
        .where(
            Submission.team_id == log.team_id,
            Submission.track == log.track,
            Submission.kind == SubmissionKind.MODEL,
            Submission.tasks.contains(log.tasks),
            Evaluation.evaluator_version == version,
            Evaluation.state == EvaluationState.COMPLETED,
        )
        .order_by(Evaluation.finished_at.desc(), Evaluation.id)
        .limit(MAX_MODELS)
    ).all()


def _actions(session: Session, key: EpisodeKey, task: str) -> ActionsByEpisode:
    rows = session.execute(
        select(EpisodeResult.episode, EpisodeResult.record["actions"])
        .where(*key.conditions(), EpisodeResult.task == task)
        .order_by(EpisodeResult.episode)
    )
    return {episode: ActionSequence.model_validate(actions) for episode, actions in rows}


def _compare(model: Evaluation, of_log: ActionsByEpisode, of_model: ActionsByEpisode) -> ActionMatchView:
    match = compare_actions(of_log, of_model)
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
