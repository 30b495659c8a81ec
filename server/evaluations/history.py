"""Evaluations of a submission, the newest first, and whether the board of a stage is what it will stay."""

from collections.abc import Collection
from functools import cache
from typing import TypeVar
from uuid import UUID

import structlog
from sqlalchemy import ScalarSelect, Select, func, select
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import InstrumentedAttribute, Session, defer, undefer
from sqlalchemy.orm.attributes import set_committed_value
from vitac.evaluator.submission_kinds import POLICY_KINDS
from vitac.evaluator.tracks.registry import find_version

from ..competitions.stages import Stage
from ..database.engine import among, among_parameter
from ..database.models import BoardResult, EpisodeDifference, Evaluation, Submission, Team, Work
from ..database.states import ACTIVE_EVALUATION_STATES, EvaluationState
from ..errors import ProblemCode, ServiceError
from ..queue.leases import Lease
from ..views.evaluations import DifferingEpisodeView
from .verdicts import ServiceVerdict

ValueT = TypeVar("ValueT")

_NEWEST_FIRST = (Evaluation.created_at.desc(), Evaluation.run.desc(), Evaluation.id)


def newest_evaluation(session: Session, submission: Submission) -> Evaluation:
    """Return the evaluation that a submission shows."""
    return session.scalars(history(submission).limit(1)).one()


def history(submission: Submission) -> Select[Evaluation]:
    """Return the evaluations of a submission, newest first."""
    return all_runs(submission).where(~Evaluation.is_proposed)


def all_runs(submission: Submission) -> Select[Evaluation]:
    """Return the evaluations of a submission with those that are only proposed, newest first."""
    return (
        select(Evaluation)
        .where(Evaluation.submission_id == submission.id)
        .order_by(*_NEWEST_FIRST)
        .execution_options(populate_existing=True)
    )


def histories(
    session: Session, submissions: Collection[Submission], *, with_output: bool = False
) -> dict[UUID, list[Evaluation]]:
    """Return all evaluations of each submission, newest first.

    Args:
        session: of the transaction.
        submissions: whose evaluations.
        with_output: with what their policies printed, which is up to 64 Ki characters each, and could import.
    """
    by_id = {submission.id: submission for submission in submissions}
    by_submission: dict[UUID, list[Evaluation]] = {submission_id: [] for submission_id in by_id}
    for evaluation in session.scalars(_select_evaluations(with_output), {"submissions": list(by_submission)}):
        set_committed_value(evaluation, "submission", by_id[evaluation.submission_id])
        by_submission[evaluation.submission_id].append(evaluation)
    return by_submission


@cache
def _select_evaluations(with_output: bool) -> Select[Evaluation]:
    """Return the query of the evaluations of `submissions`, put together once: each page of submissions asks it."""
    output = (undefer(Evaluation.packages),) if with_output else (defer(Evaluation.log_tail),)
    return (
        select(Evaluation)
        .where(among_parameter(Evaluation.submission_id, "submissions"), ~Evaluation.is_proposed)
        .options(*output)
        .order_by(*_NEWEST_FIRST)
        .execution_options(populate_existing=True)
    )


def newest_state() -> ScalarSelect[EvaluationState]:
    """Return the state of the newest evaluation of a row of `submissions`, for a query on them."""
    return select_newest(Evaluation.state)


def select_newest(column: InstrumentedAttribute[ValueT]) -> ScalarSelect[ValueT]:
    """Return a column of the newest evaluation of a row of `submissions`, for a query on them."""
    return (
        select(column)
        .where(Evaluation.submission_id == Submission.id, ~Evaluation.is_proposed)
        .order_by(Evaluation.created_at.desc(), Evaluation.run.desc())
        .limit(1)
        .scalar_subquery()
    )


logger = structlog.get_logger(__name__)


def report_difference(session: Session, lease: Lease, *, episode: int, stored: str, differing: str) -> None:
    """Keep an alarm with the evaluation; the same one again changes nothing.

    Args:
        session: of the transaction.
        lease: under which the episode was played again.
        episode: its number.
        stored: digest of the record that counts.
        differing: digest of the new record.
    """
    worker = select(Work.worker_id).where(Work.id == lease.work_id).scalar_subquery()
    session.execute(
        insert(EpisodeDifference)
        .values(
            evaluation_id=lease.evaluation_id,
            task=lease.task,
            episode=episode,
            stored_digest=stored,
            differing_digest=differing,
            worker_id=worker,
        )
        .on_conflict_do_nothing(constraint="uq_episode_differences_key")
    )
    logger.error("episode_differs_from_stored", shard=lease.work_id, episode=episode, stored=stored, new=differing)


def differing_episodes(session: Session, evaluations: Collection[Evaluation]) -> dict[UUID, list[DifferingEpisodeView]]:
    """Return the alarms of each evaluation, in the order of the episodes."""
    differing: dict[UUID, list[DifferingEpisodeView]] = {evaluation.id: [] for evaluation in evaluations}
    rows = session.scalars(
        select(EpisodeDifference)
        .where(among(EpisodeDifference.evaluation_id, differing))
        .order_by(EpisodeDifference.task, EpisodeDifference.episode, EpisodeDifference.id)
    )
    for row in rows:
        differing[row.evaluation_id].append(DifferingEpisodeView.model_validate(row, from_attributes=True))
    return differing


def count_differing_episodes() -> ScalarSelect[int]:
    """Return how many episodes of a row of `evaluations` differ, for a query on them."""
    episodes = (
        select(EpisodeDifference.task, EpisodeDifference.episode)
        .where(EpisodeDifference.evaluation_id == Evaluation.id)
        .correlate(Evaluation)
        .distinct()
        .subquery()
    )
    return select(func.count()).select_from(episodes).scalar_subquery()


def count_running(session: Session, stage: Stage) -> int:
    """Return how many evaluations of a stage wait or run."""
    query = select(func.count()).select_from(Evaluation).join(Submission)
    return session.scalars(query.where(stage.submissions, Evaluation.state.in_(ACTIVE_EVALUATION_STATES))).one()


def require_scored(session: Session, stage: Stage) -> None:
    """Refuse while an evaluation of a stage waits or runs, or the newest one of a submission was lost to machines.

    A final list has to be played first.

    Raises:
        ServiceError: stage_not_over.
    """
    if stage.live is not None and stage.played_since is None:
        raise ServiceError(
            ProblemCode.STAGE_NOT_OVER,
            f"Expected {stage} to be played; that begins by itself once the stage has closed and its evaluations have "
            f"ended, or with `vitac admin competition play-final {stage.track} {stage.live.name}`, which says what is "
            "missing.",
        )
    if running := count_running(session, stage):
        raise ServiceError(
            ProblemCode.STAGE_NOT_OVER,
            f"Expected no evaluation of {stage} that waits or runs, got {running}; wait or cancel.",
        )
    by_machines = select_newest(Evaluation.verdict_code) == ServiceVerdict.MACHINE_FAILED.value
    if lost := session.scalars(_teams(stage).where(by_machines)).all():
        raise ServiceError(
            ProblemCode.STAGE_NOT_OVER,
            f"Evaluations of {', '.join(lost)} in {stage} were lost to machines; requeue them, and "
            "cancel what cannot run.",
        )


def require_current(session: Session, stage: Stage) -> None:
    """Refuse while a model of a stage has a result of another evaluator version and was not evaluated again since.

    Raises:
        ServiceError: results_outdated.
    """
    has_result = select(BoardResult).where(BoardResult.submission_id == Submission.id).exists()
    is_stale = select_newest(Evaluation.evaluator_version) != find_version(stage.track)
    models = _teams(stage).where(Submission.kind.in_(POLICY_KINDS), has_result, is_stale)
    if stale := session.scalars(models).all():
        raise ServiceError(
            ProblemCode.RESULTS_OUTDATED,
            f"In {stage} results of {', '.join(stale)} were made by another evaluator version, so "
            "they cannot be compared. Requeue them.",
        )


def _teams(stage: Stage) -> Select[str]:
    """Return the names of the teams with a submission to a stage; what is disqualified or withdrawn holds nobody up."""
    taking_part = Team.disqualified_at.is_(None), ~Submission.is_off_boards
    return select(Team.name).join(Submission).where(stage.submissions, *taking_part).distinct().order_by(Team.name)
