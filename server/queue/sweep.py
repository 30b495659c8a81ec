"""Finds work that was lost and sets it going again; every worker and every server runs it all the time.

Lost means: a shard whose worker did not renew its lease, or a queued shard without a job. The shards' table decides; a
job too many does no harm, because a shard can be claimed only once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta

import structlog
from sqlalchemy import ColumnElement, Interval, cast, func, select, text
from sqlalchemy.orm import Session
from vitac.server.db.models import Evaluation, Shard
from vitac.server.db.states import ShardState
from vitac.server.evaluations.evaluations import fail_by_machines
from vitac.server.settings import Settings

from .jobs import ONCE_MORE, RUN_SHARD, enqueue_shards
from .leases import lock_evaluation

logger = structlog.get_logger(__name__)

SWEEP_LOCK = 0x7669_7461_6302
"""Advisory lock: one sweep at a time is enough."""


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """What one sweep did, as numbers of shards."""

    queued_again: int = 0
    given_up: int = 0
    woken: int = 0


def sweep(session: Session, settings: Settings) -> Sweep:
    """Queues lost shards again, gives up those that were lost too often, and enqueues missing jobs."""
    if not session.scalar(text("SELECT pg_try_advisory_xact_lock(:key)"), {"key": SWEEP_LOCK}):
        return Sweep()
    queued_again = given_up = 0
    for shard_id in _shards_with_expired_lease(session, settings):
        again = _recover(session, shard_id, settings)
        queued_again, given_up = queued_again + again, given_up + (not again)
    woken = _enqueue_missing_jobs(session, settings)
    _forget_jobs_of_ended_shards(session)
    return Sweep(queued_again=queued_again, given_up=given_up, woken=woken)


def _shards_with_expired_lease(session: Session, settings: Settings) -> Sequence[int]:
    # After a restart of the database every worker gets a full lease to speak again: it could not renew meanwhile.
    server_is_up = func.pg_postmaster_start_time() < _ago(settings.lease_s)
    return session.scalars(
        select(Shard.id)
        .where(Shard.state == ShardState.RUNNING, Shard.lease_expires_at < func.clock_timestamp(), server_is_up)
        .order_by(Shard.id)
    ).all()


def _recover(session: Session, shard_id: int, settings: Settings) -> bool:
    """Queues one lost shard again, or ends its evaluation; whether the first."""
    shard = session.get_one(Shard, shard_id)
    evaluation = lock_evaluation(session, shard.evaluation_id)
    session.refresh(shard, with_for_update=True)
    if shard.state is not ShardState.RUNNING:
        return True
    if shard.attempts >= settings.shard_attempts:
        logger.error("shard_given_up", shard=shard_id, attempts=shard.attempts)
        fail_by_machines(session, evaluation, _explain(shard))
        return False
    logger.warning("shard_lost", shard=shard_id, worker=str(shard.worker_id), attempts=shard.attempts)
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
    enqueue_shards(session, [shard.id], evaluation.evaluator_version, priority=ONCE_MORE)


def _explain(shard: Shard) -> str:
    first, last = shard.episodes[0], shard.episodes[-1]
    return (
        f"Episodes {first} to {last} of {shard.task} were started {shard.attempts} times, "
        "and each time the worker fell silent before their end."
    )


def _enqueue_missing_jobs(session: Session, settings: Settings) -> int:
    """Wakes queued shards that nothing else will: their job was taken by a worker that never claimed the shard."""
    waiting = select(text("1")).where(
        text(
            "EXISTS (SELECT FROM procrastinate_jobs job WHERE job.task_name = :task "
            "AND (job.args ->> 'shard_id')::bigint = shards.id "
            "AND (job.status = 'todo' OR EXISTS (SELECT FROM procrastinate_events event WHERE event.job_id = job.id "
            "AND event.type = 'started' AND event.at > clock_timestamp() - CAST(:lately AS interval))))"
        ).bindparams(task=RUN_SHARD, lately=timedelta(seconds=settings.lease_s))
    )
    rows = session.execute(
        select(Shard.id, Evaluation.evaluator_version)
        .join(Evaluation)
        .where(Shard.state == ShardState.QUEUED, Shard.queued_at < _ago(settings.lease_s), ~waiting.exists())
        .order_by(Shard.id)
    ).all()
    for shard_id, version in rows:
        enqueue_shards(session, [shard_id], version, priority=ONCE_MORE)
    return len(rows)


def _forget_jobs_of_ended_shards(session: Session) -> None:
    """Jobs that a dead worker has left as running, once their shard has no lease."""
    session.execute(
        text(
            "DELETE FROM procrastinate_jobs job USING shards WHERE job.status = 'doing' AND job.task_name = :task "
            "AND shards.id = (job.args ->> 'shard_id')::bigint AND shards.state <> 'running' "
            "AND NOT EXISTS (SELECT FROM procrastinate_workers worker WHERE worker.id = job.worker_id "
            "AND worker.last_heartbeat > now() - interval '1 minute')"
        ),
        {"task": RUN_SHARD},
    )


def _ago(seconds: float) -> ColumnElement[object]:
    return func.clock_timestamp() - cast(timedelta(seconds=seconds), Interval)
