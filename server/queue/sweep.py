"""Finds work that was lost and sets it going again; every worker runs it all the time, and of each server one process.

Lost means: a shard whose worker did not renew its lease, or a queued shard without a job. The shards' table decides; a
job too many does no harm, because a shard can be claimed only once. A process that stands still in the middle of a
transaction holds its locks: the sweep passes over what it holds, and loses its own if it stands still itself.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import timedelta
from functools import partial

import structlog
from sqlalchemy import ColumnElement, Interval, Select, cast, func, select, text
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family

from ..database.locks import AdvisoryLock, try_lock, try_lock_evaluation, unless_held
from ..database.models import Evaluation, Shard, Submission
from ..database.states import RepeatCause, ShardState
from ..settings import Settings
from ..tracks import find_family
from .jobs import (
    RETRY_PRIORITY,
    enqueue_shards,
    forget_jobs_of_ended_shards,
    has_taken_job,
    has_waiting_job,
    queue_name,
)
from .repeats import count_losses, make_repeat

logger = structlog.get_logger(__name__)

TRIAL_LOSSES = 10
"""A killed agent of a station costs its trial no attempt, as the policy did nothing wrong, but not more often."""

IDLE_LIMIT = "10s"
"""The database ends a sweep whose process does nothing for this time, and another one takes over."""

GiveUp = Callable[[Session, Evaluation, str], None]
"""Ends an evaluation, locked, whose shard was lost in all its attempts; the text says what was lost."""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """What one sweep did, as numbers of shards."""

    queued_again: int = 0
    given_up: int = 0
    woken: int = 0


def sweep(session: Session, settings: Settings, *, give_up: GiveUp) -> Sweep:
    """Queue lost shards again, give up those that were lost too often, and enqueue missing jobs."""
    if not try_lock(session, AdvisoryLock.SWEEP):
        return Sweep()
    session.execute(text(f"SET LOCAL idle_in_transaction_session_timeout = '{IDLE_LIMIT}'"))
    expired = _shards_with_expired_lease(session, settings)
    recovered = [unless_held(session, partial(_recover, session, shard_id, settings, give_up)) for shard_id in expired]
    woken = _enqueue_missing_jobs(session, settings)
    forget_jobs_of_ended_shards(session)
    return Sweep(queued_again=recovered.count(True), given_up=recovered.count(False), woken=woken)


def _shards_with_expired_lease(session: Session, settings: Settings) -> Sequence[int]:
    # After a restart of the database every worker gets a full lease of time to renew again: it could not meanwhile.
    server_is_up = func.pg_postmaster_start_time() < _ago(settings.lease_s)
    return session.scalars(
        select(Shard.id)
        .where(Shard.state == ShardState.RUNNING, Shard.lease_expires_at < func.clock_timestamp(), server_is_up)
        .order_by(Shard.id)
    ).all()


def _recover(session: Session, shard_id: int, settings: Settings, give_up: GiveUp) -> bool | None:
    """Queue one lost shard again, or give its evaluation up; whether the first.

    None: it is not lost after all, or somebody holds it or its evaluation; then the next sweep looks again.
    """
    evaluation = try_lock_evaluation(session, session.get_one(Shard, shard_id).evaluation_id)
    if evaluation is None:
        return None
    found = select(Shard).where(Shard.id == shard_id, Shard.state == ShardState.RUNNING)
    free = found.with_for_update(skip_locked=True).execution_options(populate_existing=True)
    shard = session.scalars(free).one_or_none()
    if shard is None:
        return None
    is_station = find_family(evaluation.submission.track, shard.task) is Family.STATION
    if is_station and count_losses(shard) < TRIAL_LOSSES:
        shard.attempts = max(shard.attempts - 1, 0)
    if shard.attempts >= settings.shard_attempts:
        give_up(session, evaluation, _explain(shard))
        logger.error("shard_given_up", shard=shard_id, evaluation=str(evaluation.id), attempts=shard.attempts)
        return False
    logger.warning(
        "shard_lost",
        shard=shard_id,
        evaluation=str(evaluation.id),
        worker=str(shard.worker_id),
        attempts=shard.attempts,
    )
    shard.repeats = [*shard.repeats, make_repeat(RepeatCause.LOST, f"The worker {shard.worker_id} was lost.")]
    _queue_again(session, shard, evaluation)
    return True


def _queue_again(session: Session, shard: Shard, evaluation: Evaluation) -> None:
    now = session.scalars(select(func.clock_timestamp())).one()
    shard.state = ShardState.QUEUED
    shard.token += 1
    shard.worker_id = None
    shard.lease_expires_at = None
    shard.queued_at = now
    session.flush()
    queue = queue_name(evaluation.evaluator_version, find_family(evaluation.submission.track, shard.task))
    enqueue_shards(session, [shard.id], queue, priority=RETRY_PRIORITY)


def _explain(shard: Shard) -> str:
    first, last = shard.episodes[0], shard.episodes[-1]
    return (
        f"Episodes {first} to {last} of {shard.task} were started {shard.attempts} times, "
        "and each time the worker was lost before it had stored one more."
    )


def _enqueue_missing_jobs(session: Session, settings: Settings) -> int:
    """Wake queued shards that nothing else will: their job was taken by a worker that never claimed the shard."""
    rows = session.execute(shards_without_job(settings)).all()
    by_turn: dict[tuple[str, int], list[int]] = {}
    for shard_id, version, turn, track, task in rows:
        by_turn.setdefault((queue_name(version, find_family(track, task)), turn), []).append(shard_id)
    for (queue, turn), shard_ids in by_turn.items():
        enqueue_shards(session, shard_ids, queue, priority=-turn)
    return len(rows)


def shards_without_job(settings: Settings) -> Select[int, str, int, str, str]:
    """Return the queued shards that no job wakes: version and turn of the evaluation, track and task."""
    return (
        select(Shard.id, Evaluation.evaluator_version, Evaluation.turn, Submission.track, Shard.task)
        .join(Evaluation, Shard.evaluation_id == Evaluation.id)
        .join(Submission, Evaluation.submission_id == Submission.id)
        .where(
            Shard.state == ShardState.QUEUED,
            Shard.queued_at < _ago(settings.lease_s),
            # Apart, not joined by OR: so each is looked up in an index once for all shards.
            ~has_waiting_job(),
            ~has_taken_job(started_within=timedelta(seconds=settings.lease_s)),
        )
        .order_by(Shard.id)
    )


def _ago(seconds: float) -> ColumnElement[object]:
    return func.clock_timestamp() - cast(timedelta(seconds=seconds), Interval)
