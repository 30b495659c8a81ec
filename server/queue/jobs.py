"""The job queue (procrastinate): jobs are enqueued in the transaction of the rows that they are about.

A job is a wake-up call that names a shard or a playback. The row decides whether there is work and who may do it, so
a job that is lost or doubled does no harm.
"""

from collections.abc import Iterable
from datetime import timedelta
from typing import Any, cast

import procrastinate
import psycopg
from procrastinate import PsycopgConnector, SyncPsycopgConnector
from procrastinate.exceptions import ConnectorException
from sqlalchemy import ColumnElement, TextClause, select, text
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family

RUN_SHARD = "run_shard"

MAKE_PLAYBACK = "make_playback"

RETRY_PRIORITY = 1
"""Priority of a shard that comes back: before all that wait for the first time, whose priority is minus their turn."""

PLAYBACK_PRIORITY = -2_000_000_000
"""Priority of playbacks: after all shards."""

_enqueuer = procrastinate.App(connector=SyncPsycopgConnector())
"""Never opened: each call brings the connection of the caller's transaction."""


_WITHDRAW = text("""
    DELETE FROM procrastinate_jobs
    WHERE status = 'todo' AND task_name = :task AND (args ->> 'shard_id')::bigint = ANY(:shards)
""")

_PRUNE = text("""
    DELETE FROM procrastinate_jobs job
    WHERE status IN ('succeeded', 'failed', 'cancelled', 'aborted')
      AND NOT EXISTS (SELECT 1 FROM procrastinate_events event
                      WHERE event.job_id = job.id AND event.at > now() - CAST(:age AS interval))
    RETURNING id
""")

_FORGET = text("""
    DELETE FROM procrastinate_jobs job USING shards
    WHERE job.status = 'doing' AND job.task_name = :task
      AND shards.id = (job.args ->> 'shard_id')::bigint AND shards.state <> 'running'
      AND NOT EXISTS (SELECT FROM procrastinate_workers worker
                      WHERE worker.id = job.worker_id AND worker.last_heartbeat > now() - interval '1 minute')
""")

_FORGET_PLAYBACKS = text("""
    DELETE FROM procrastinate_jobs job
    WHERE job.status = 'doing' AND job.task_name = :task
      AND NOT EXISTS (SELECT FROM playbacks
                      WHERE playbacks.id = (job.args ->> 'playback_id')::bigint AND playbacks.state = 'running')
      AND NOT EXISTS (SELECT FROM procrastinate_workers worker
                      WHERE worker.id = job.worker_id AND worker.last_heartbeat > now() - interval '1 minute')
""")

_WAITS_FOR_PLAYBACK = text("""
    job.status = 'todo' AND job.task_name = :task AND (job.args ->> 'playback_id')::bigint = playbacks.id
""")

_WAITS_FOR_SHARD = text("""
    job.status = 'todo' AND job.task_name = :task AND (job.args ->> 'shard_id')::bigint = shards.id
""")

_WAS_TAKEN_FOR_SHARD = text("""
    job.status = 'doing' AND job.task_name = :task AND (job.args ->> 'shard_id')::bigint = shards.id
    AND EXISTS (SELECT FROM procrastinate_events event
                WHERE event.job_id = job.id AND event.type = 'started'
                  AND event.at > statement_timestamp() - CAST(:started_within AS interval))
""")


def queue_name(evaluator_version: str, family: Family = Family.TACTILE) -> str:
    """Queue of the shards and playbacks of one evaluator version and family: workers that can run both take them."""
    return f"shards {evaluator_version}" + ("" if family is Family.TACTILE else f" {family}")


def enqueue_shards(
    session: Session,
    shard_ids: Iterable[int],
    queue: str,
    *,
    delay_s: float = 0.0,
    priority: int,
) -> None:
    """Add one job per shard; they become visible when the session commits, and never if it rolls back.

    Args:
        session: of the transaction.
        shard_ids: what to run, in this order.
        queue: from `queue_name`.
        delay_s: how long they wait at least [s].
        priority: high ones first; minus the turn of their evaluation, or `RETRY_PRIORITY`.

    Raises:
        DBAPIError: the database failed.
    """
    arguments: list[Any] = [{"shard_id": shard_id} for shard_id in shard_ids]
    if arguments:
        _enqueue(session, RUN_SHARD, arguments, queue, delay_s=delay_s, priority=priority)


def enqueue_playback(session: Session, playback_id: int, queue: str, *, delay_s: float = 0.0) -> None:
    """Add the job of a playback, which comes after all shards; visible when the session commits.

    Raises:
        DBAPIError: the database failed.
    """
    arguments = [{"playback_id": playback_id}]
    _enqueue(session, MAKE_PLAYBACK, arguments, queue, delay_s=delay_s, priority=PLAYBACK_PRIORITY)


def _enqueue(session: Session, task: str, arguments: list[Any], queue: str, *, delay_s: float, priority: int) -> None:
    deferrer = _enqueuer.configure_task(
        task,
        queue=queue,
        connection=raw_connection(session),
        priority=priority,
        schedule_in={"milliseconds": round(1000 * delay_s)} if delay_s else None,
    )
    try:
        deferrer.batch_defer(*arguments)
    except ConnectorException as error:
        raise _database_error(error) from error


def _database_error(error: ConnectorException) -> Exception:
    """Return what went wrong in the database as our own statements raise it: it is retried and answered alike."""
    cause = error.__cause__
    return OperationalError("enqueue", {}, cause) if isinstance(cause, psycopg.Error) else error


def raw_connection(session: Session) -> "psycopg.Connection[Any]":
    """Return the driver's connection below a session, inside its transaction."""
    return cast("psycopg.Connection[Any]", session.connection().connection.driver_connection)


def withdraw_jobs(session: Session, shard_ids: Iterable[int]) -> None:
    """Remove waiting jobs of shards that no longer need a worker."""
    session.execute(_WITHDRAW, {"task": RUN_SHARD, "shards": list(shard_ids)})


def prune_finished_jobs(session: Session, older_than: timedelta) -> int:
    """Remove jobs that finished longer ago than `older_than`; return how many."""
    return len(session.execute(_PRUNE, {"age": older_than}).all())


def forget_jobs_of_ended_shards(session: Session) -> None:
    """Remove jobs that a dead worker has left as running, once their shard has no lease."""
    session.execute(_FORGET, {"task": RUN_SHARD})


def forget_jobs_of_ended_playbacks(session: Session) -> None:
    """Remove jobs that a dead worker has left as running, once their playback has no lease."""
    session.execute(_FORGET_PLAYBACKS, {"task": MAKE_PLAYBACK})


def has_waiting_playback_job() -> ColumnElement[bool]:
    """Return whether a row of `playbacks` has a job that waits."""
    return _has_job(_WAITS_FOR_PLAYBACK.bindparams(task=MAKE_PLAYBACK))


def has_waiting_job() -> ColumnElement[bool]:
    """Return whether a row of `shards` has a job that waits."""
    return _has_job(_WAITS_FOR_SHARD.bindparams(task=RUN_SHARD))


def has_taken_job(*, started_within: timedelta) -> ColumnElement[bool]:
    """Return whether a row of `shards` has a job started so recently that its worker may still claim the shard."""
    return _has_job(_WAS_TAKEN_FOR_SHARD.bindparams(task=RUN_SHARD, started_within=started_within))


def _has_job(condition: TextClause) -> ColumnElement[bool]:
    return select(text("1")).select_from(text("procrastinate_jobs job")).where(condition).exists()


def make_worker_app(address: str) -> procrastinate.App:
    """Return the queue as a worker uses it: asynchronous, with connections of its own."""
    return procrastinate.App(connector=PsycopgConnector(conninfo=address, min_size=1, max_size=4))
