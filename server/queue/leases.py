"""Leases on shards: claim, renewal, and the ways in which a lease ends.

Each claim raises the shard's token. Every later statement names the token, so a worker that was paused, and whose shard
went to another one, no longer changes anything: its next statement raises `LeaseLost`.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import timedelta
from typing import Any
from uuid import UUID

from sqlalchemy import Interval, cast, func, select, update
from sqlalchemy.dialects.postgresql import JSONB
from sqlalchemy.orm import Session
from vitac.envs.errors import VitacError
from vitac.evaluator.shards.order import ShardResult
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks.registry import find_version

from .. import traces
from ..database.locks import lock_evaluation
from ..database.models import Evaluation, Shard, SubmissionFile
from ..database.states import EvaluationState, FileRole, RepeatCause, ShardState
from ..tracks import find_family
from .jobs import RETRY_PRIORITY, enqueue_shards, queue_name
from .repeats import make_repeat


class LeaseLost(VitacError):
    """The shard belongs to another worker or its evaluation has ended: stop working on it and report nothing."""


@dataclass(frozen=True, kw_only=True)
class Lease:
    """The right to work on one shard, and all that is needed for it.

    Attributes:
        commitment: of the sealed list that is played; None for the public one.
        waited_s: how long the shard was queued [s].
        traceparent: trace of the request that its evaluation began in.
    """

    shard_id: int
    token: int
    attempt: int
    evaluation_id: UUID
    submission_id: UUID
    kind: SubmissionKind
    submission_digest: str
    evaluator_version: str
    track: str
    run: int
    commitment: str | None
    archive_sha256: str
    sensor_sha256: str | None
    task: str
    number: int
    episodes: tuple[int, ...]
    waited_s: float
    traceparent: str | None = None


def claim(session: Session, shard_id: int, worker_id: UUID, lease_s: float) -> Lease | None:
    """Take a queued shard; None when there is nothing to do (taken, finished, cancelled, of another evaluator).

    A running shard is not taken away here: the sweep queues it again when its lease has run out.
    """
    evaluation = _lock_evaluation(session, shard_id)
    if evaluation is None or evaluation.evaluator_version != find_version(evaluation.submission.track):
        return None
    shard = session.get(Shard, shard_id, with_for_update=True, populate_existing=True)
    if shard is None or shard.state is not ShardState.QUEUED:
        return None
    now = session.scalars(select(func.clock_timestamp())).one()
    shard.state = ShardState.RUNNING
    shard.token += 1
    shard.attempts += 1
    shard.worker_id = worker_id
    shard.lease_expires_at = now + timedelta(seconds=lease_s)
    shard.started_at = shard.progressed_at = now
    if evaluation.state is EvaluationState.QUEUED:
        evaluation.state = EvaluationState.RUNNING
        evaluation.started_at = now
    submission = evaluation.submission
    return Lease(
        shard_id=shard.id,
        token=shard.token,
        attempt=shard.attempts,
        evaluation_id=evaluation.id,
        submission_id=submission.id,
        kind=submission.kind,
        submission_digest=submission.digest,
        evaluator_version=evaluation.evaluator_version,
        track=submission.track,
        run=evaluation.run,
        commitment=shard.commitment or None,
        archive_sha256=submission.archive_sha256,
        sensor_sha256=_find_sensor(session, submission.id),
        task=shard.task,
        number=shard.number,
        episodes=tuple(shard.episodes),
        waited_s=(now - shard.queued_at).total_seconds(),
        traceparent=evaluation.traceparent if traces.are_asked_for() else None,
    )


def _find_sensor(session: Session, submission_id: UUID) -> str | None:
    return session.scalar(
        select(SubmissionFile.sha256).where(
            SubmissionFile.submission_id == submission_id, SubmissionFile.role == FileRole.SENSOR
        )
    )


def renew(session: Session, lease: Lease, lease_s: float) -> None:
    """Keep the shard for another while.

    Raises:
        LeaseLost: it is no longer ours, for example because the evaluation was cancelled.
    """
    _change_held(session, lease, lease_expires_at=lease_end(lease_s))


def lock_held(session: Session, lease: Lease) -> int:
    """Keep others from ending the lease until the end of the transaction; return the attempts without progress.

    Raises:
        LeaseLost: the shard is no longer ours.
    """
    attempts = session.scalar(select(Shard.attempts).where(*_held(lease)).with_for_update())
    if attempts is None:
        raise _lost(lease)
    return attempts


def note_progress(session: Session, lease: Lease) -> None:
    """Note that the shard has got further now; attempts are counted from zero again, this one included.

    Raises:
        LeaseLost: the shard is no longer ours.
    """
    _change_held(session, lease, attempts=0, progressed_at=func.clock_timestamp())


def store_packages_digest(session: Session, lease: Lease, digest: str) -> None:
    """Store which list of packages the shard's policy sees.

    Raises:
        LeaseLost: the shard is no longer ours.
    """
    _change_held(session, lease, packages_digest=digest)


def end_shard(session: Session, lease: Lease, state: ShardState, result: ShardResult) -> None:
    """Mark the shard as done or failed.

    Raises:
        LeaseLost: the shard is no longer ours.
    """
    _change_held(
        session,
        lease,
        state=state,
        manifest=result.manifest.model_dump(mode="json"),
        isolation=_read_isolation(result),
        finding=result.finding.model_dump(mode="json") if result.finding else None,
        lease_expires_at=None,
        finished_at=func.clock_timestamp(),
    )


def hand_back(
    session: Session, lease: Lease, *, counts_as_attempt: bool, delay_s: float = 0.0, broke: str | None = None
) -> None:
    """Queue the shard again for the next free worker (after a while), for example when the worker stops.

    Args:
        session: of the change.
        lease: on the shard.
        counts_as_attempt: whether the shard comes nearer to its last attempt.
        delay_s: how long it waits.
        broke: what its machine could not do, which is noted.

    Raises:
        LeaseLost: the shard is no longer ours.
    """
    noted = [make_repeat(RepeatCause.BROKE, broke)] if broke else []
    _change_held(
        session,
        lease,
        state=ShardState.QUEUED,
        attempts=Shard.attempts if counts_as_attempt else func.greatest(Shard.attempts - 1, 0),
        repeats=Shard.repeats.concat(cast(noted, JSONB)),
        lease_expires_at=None,
        worker_id=None,
        queued_at=func.clock_timestamp(),
    )
    queue = queue_name(lease.evaluator_version, find_family(lease.track, lease.task))
    enqueue_shards(session, [lease.shard_id], queue, delay_s=delay_s, priority=RETRY_PRIORITY)


def _read_isolation(result: ShardResult) -> str | None:
    """Return the level of isolation as one string; None when no policy ran because all episodes were stored."""
    if result.isolation is None:
        return None
    return ", ".join(f"{name.replace('_', ' ')}: {value}" for name, value in asdict(result.isolation).items())


def _lock_evaluation(session: Session, shard_id: int) -> Evaluation | None:
    evaluation_id = session.scalar(select(Shard.evaluation_id).where(Shard.id == shard_id))
    return lock_evaluation(session, evaluation_id) if evaluation_id is not None else None


def _held(lease: Lease) -> Sequence[Any]:
    return (Shard.id == lease.shard_id, Shard.token == lease.token, Shard.state == ShardState.RUNNING)


def _change_held(session: Session, lease: Lease, **values: Any) -> None:
    changed = session.scalar(
        update(Shard)
        .where(*_held(lease))
        .values(**values)
        .returning(Shard.id)
        .execution_options(synchronize_session=False)
    )
    if changed is None:
        raise _lost(lease)


def lease_end(lease_s: float) -> Any:
    """Return the time, by the database's clock, at which a lease that is renewed now runs out."""
    return func.clock_timestamp() + cast(timedelta(seconds=lease_s), Interval)


def _lost(lease: Lease) -> LeaseLost:
    return LeaseLost(f"Shard {lease.shard_id} is no longer held under token {lease.token}.")
