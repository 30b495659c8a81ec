"""Submissions as those read them who may: one, a page of them, the episodes of one."""

from collections.abc import Sequence
from typing import Any
from uuid import UUID

from sqlalchemy import ColumnElement, Float, func, null, select, tuple_
from sqlalchemy.orm import Session, joinedload

from ..accounts import teams
from ..cache import Cache
from ..competitions.competition import Competition
from ..database.models import EpisodeResult, Evaluation, Submission
from ..database.states import EvaluationState
from ..errors import ProblemCode, ServiceError
from ..evaluations.episode_store import EpisodeKey, find_shown_key
from ..evaluations.history import histories, newest_evaluation, newest_state
from ..leaderboards.public_pages import readable
from ..principals import Principal
from ..settings import Settings
from ..tracks import known_track
from ..views.submissions import ArchiveContents, EpisodeView, ModelCardView, SubmissionListView, SubmissionView
from ..visibility import visible
from .view import submission_views

_ends: Cache[tuple[UUID, str], Sequence[EpisodeView]] = Cache(at_most=128)
"""Episodes by evaluation and list, about 150 kB each. They do not change: a completed evaluation has all of them."""


def get(session: Session, settings: Settings, by: Principal, submission_id: UUID) -> SubmissionView:
    """Return one submission with its newest evaluation.

    Raises:
        ServiceError: there is none that the principal may see.
    """
    runs = histories(session, [readable(session, by, submission_id)], with_output=True)
    return submission_views(session, settings, runs, by, with_output=True)[0]


def list_submissions(
    session: Session,
    settings: Settings,
    by: Principal,
    *,
    competition: str | None = None,
    track: str | None = None,
    state: EvaluationState | None = None,
    team: str | None = None,
    before: UUID | None = None,
    limit: int = 50,
) -> SubmissionListView:
    """Return a page of the team's submissions, or of all teams' for organizers and judges; newest first.

    Raises:
        ServiceError: `competition`, `before` or `team` names nothing that the principal may see.
    """
    query = select(Submission).options(joinedload(Submission.team))
    if by.competition is not None:
        query = query.where(Submission.competition == by.competition)
    elif not by.reads_all_teams:
        query = query.where(Submission.team_id == by.team_id)
    if (by.reads_all_teams or by.competition is not None) and team is not None:
        query = query.where(Submission.team_id == teams.find(session, team).id)
    if competition is not None:
        query = query.where(Submission.competition == Competition.find(session, competition).name)
    if track is not None:
        query = query.where(Submission.track == track)
    if state is not None:
        query = query.where(newest_state() == state)
    if before is not None:
        last = visible(session, by, before)
        query = query.where(tuple_(Submission.submitted_at, Submission.id) < tuple_(last.submitted_at, last.id))
    rows = session.scalars(query.order_by(Submission.submitted_at.desc(), Submission.id.desc()).limit(limit + 1)).all()
    return SubmissionListView(
        items=submission_views(session, settings, histories(session, rows[:limit]), by),
        next_before=rows[limit - 1].id if len(rows) > limit else None,
    )


def episodes(session: Session, by: Principal, submission_id: UUID, *, practice: bool = False) -> Sequence[EpisodeView]:
    """Return how each finished episode of the newest evaluation ended, in order; none where they are not shown.

    Args:
        session: of the transaction.
        by: who asks.
        submission_id: of the submission.
        practice: of the public list that was played beside a sealed one, instead of those of the result.

    Raises:
        ServiceError: there is no such submission.
    """
    evaluation = newest_evaluation(session, readable(session, by, submission_id))
    return list_episodes(session, by, evaluation, practice=practice)


def list_episodes(
    session: Session, by: Principal, evaluation: Evaluation, *, practice: bool = False
) -> Sequence[EpisodeView]:
    """Return the same of an evaluation."""
    key = find_shown_key(session, by, evaluation, practice=practice)
    if key is None:
        return ()
    if evaluation.state is not EvaluationState.COMPLETED:
        return _read_episodes(session, key)
    return _ends.get((evaluation.id, key.commitment), lambda: _read_episodes(session, key))


def _read_episodes(session: Session, key: EpisodeKey) -> Sequence[EpisodeView]:
    rows = session.execute(
        select(
            EpisodeResult.task,
            EpisodeResult.episode,
            EpisodeResult.shape,
            EpisodeResult.initial_offset,
            EpisodeResult.outcome,
            EpisodeResult.success,
            EpisodeResult.env_steps,
            EpisodeResult.forces,
            _drawn(key.track).label("drawn"),
        )
        .where(*key.conditions())
        .order_by(EpisodeResult.task, EpisodeResult.episode)
    )
    return tuple(EpisodeView.from_row(row, draws=row.drawn or {}) for row in rows)


def _drawn(track: str) -> ColumnElement[Any]:
    """Return what was drawn for an episode, of a track that draws anything: reading whole records takes time."""
    known = known_track(track)
    draws = known is not None and any(task.draws for task in known.tasks.values())
    return EpisodeResult.record[("infos", 0, "draws")] if draws else null()


_times: Cache[UUID, float] = Cache(at_most=1024)
"""By evaluation: to sum them up, the database unpacks every record."""


def model_card(session: Session, by: Principal, submission_id: UUID) -> ModelCardView:
    """Return the card of a model.

    Raises:
        ServiceError: there is no such submission, or it is a log.
    """
    submission = readable(session, by, submission_id)
    if not submission.kind.form.has_card:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_SUBMISSION_KIND,
            f"Expected a model, got a submission of kind {submission.kind}: only models have a card.",
        )
    return make_card(session, by, newest_evaluation(session, submission))


def make_card(session: Session, by: Principal, evaluation: Evaluation) -> ModelCardView:
    """Return the card of an evaluated model."""
    submission = evaluation.submission
    contents = submission.contents
    return ModelCardView.from_row(
        submission,
        observation_keys=submission.manifest.get("observation_keys"),
        control_modes=submission.manifest.get("control_modes") or {},
        contents=None if contents is None else ArchiveContents.model_validate(contents),
        policy_ms=_find_policy_ms(session, by, evaluation),
    )


def _find_policy_ms(session: Session, by: Principal, evaluation: Evaluation) -> float | None:
    key = find_shown_key(session, by, evaluation)
    if key is None or evaluation.state is not EvaluationState.COMPLETED:
        return None
    return _times.get(evaluation.id, lambda: _read_policy_ms(session, key))


def _read_policy_ms(session: Session, key: EpisodeKey) -> float:
    policy_s = EpisodeResult.record[("timings", "policy_s")].astext.cast(Float)
    total_s, env_steps = session.execute(
        select(func.sum(policy_s), func.sum(EpisodeResult.env_steps)).where(*key.conditions())
    ).one()
    return 1000.0 * (total_s or 0.0) / max(1, env_steps or 0)
