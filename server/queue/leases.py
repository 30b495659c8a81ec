"""Leases on what evaluations are made of: what a worker needs for it, and how a shard ends. `work` has the rest."""

import secrets
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any
from uuid import UUID

from sqlalchemy import bindparam, select, update
from sqlalchemy.orm import Session, contains_eager
from vitac.evaluator.shards.order import ShardResult
from vitac.evaluator.submission_kinds import SubmissionKind

from .. import traces
from ..database.clock import read_clock
from ..database.locks import lock_evaluation
from ..database.models import Evaluation, SensorCheck, Shard, SubmissionFile, Trial
from ..database.states import EvaluationState, FileRole, WorkState
from .work import Claim, end, lock_held, lost

_CODE_BYTES = 8


@dataclass(frozen=True, kw_only=True)
class Lease(Claim):
    """The right to work on one shard, and all that is needed for it.

    Attributes:
        commitment: of the sealed list that is played; None for the public one.
        traceparent: trace of the request that its evaluation began in.
        code: one-time code of a trial, which its video shows; None elsewhere.
    """

    evaluation_id: UUID
    submission_id: UUID
    submission_kind: SubmissionKind
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
    traceparent: str | None = None
    code: str | None = None


_SENSOR = select(SubmissionFile.sha256).where(
    SubmissionFile.submission_id == Evaluation.submission_id, SubmissionFile.role == FileRole.SENSOR
)
_BEGUN = (
    select(Shard, _SENSOR.correlate(Evaluation).scalar_subquery())
    .join(Shard.evaluation)
    .where(Shard.id == bindparam("id"))
    .options(contains_eager(Shard.evaluation).joinedload(Evaluation.submission))
    .execution_options(populate_existing=True)
)
"""All that a shard is played with, in one statement."""


def begin(session: Session, claim: Claim) -> Lease:
    """Return the lease on a claimed shard, whose evaluation runs from now on.

    Raises:
        LeaseLost: the shard is no longer ours.
    """
    shard, sensor = session.execute(_BEGUN, {"id": claim.work_id}).one()
    if (shard.token, shard.state) != (claim.token, WorkState.RUNNING):
        raise lost(claim)
    evaluation, submission = shard.evaluation, shard.evaluation.submission
    if evaluation.state is EvaluationState.QUEUED:
        lock_evaluation(session, evaluation.id)
        lock_held(session, claim)
        evaluation.state = EvaluationState.RUNNING
        evaluation.started_at = read_clock(session)
    if isinstance(shard, Trial):
        lock_held(session, claim)
        shard.code = secrets.token_hex(_CODE_BYTES).upper()
    return Lease(
        **vars(claim),
        evaluation_id=evaluation.id,
        submission_id=submission.id,
        submission_kind=submission.kind,
        submission_digest=submission.digest,
        evaluator_version=evaluation.evaluator_version,
        track=submission.track,
        run=evaluation.run,
        commitment=shard.commitment or None,
        archive_sha256=submission.archive_sha256,
        sensor_sha256=sensor,
        task=shard.task,
        number=shard.number,
        episodes=tuple(shard.episodes),
        traceparent=evaluation.traceparent if traces.are_asked_for() else None,
        code=shard.code,
    )


@dataclass(frozen=True, kw_only=True)
class CheckLease(Claim):
    """The right to check the sensor of a submission."""

    submission_id: UUID
    archive_sha256: str


def begin_check(session: Session, claim: Claim) -> CheckLease:
    """Return the lease on a claimed check of a sensor."""
    submission = session.get_one(SensorCheck, claim.work_id).evaluation.submission
    return CheckLease(**vars(claim), submission_id=submission.id, archive_sha256=submission.archive_sha256)


def store_packages_digest(session: Session, lease: Lease, digest: str) -> None:
    """Store which list of packages the shard's policy sees.

    Raises:
        LeaseLost: the shard is no longer ours.
    """
    lock_held(session, lease)
    _change(session, lease, packages_digest=digest)


def end_shard(session: Session, lease: Lease, state: WorkState, result: ShardResult) -> None:
    """Mark the shard as done or failed.

    Raises:
        LeaseLost: the shard is no longer ours.
    """
    end(session, lease, state)
    _change(
        session,
        lease,
        manifest=result.manifest.model_dump(mode="json"),
        isolation=_read_isolation(result),
        finding=result.finding.model_dump(mode="json") if result.finding else None,
    )


def _change(session: Session, lease: Lease, **values: Any) -> None:
    """Change columns of the shard, whose row in the queue is locked."""
    changed = update(Shard).where(Shard.id == lease.work_id).values(**values)
    session.execute(changed.execution_options(synchronize_session=False))


def _read_isolation(result: ShardResult) -> str | None:
    """Return the level of isolation as one string; None when no policy ran because all episodes were stored."""
    if result.isolation is None:
        return None
    levels: Mapping[str, Any] = asdict(result.isolation)
    return ", ".join(f"{name.replace('_', ' ')}: {value}" for name, value in levels.items())
