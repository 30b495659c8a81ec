"""What an evaluation was made with: manifests of its shards, isolation of the policy, and packages it could import."""

from collections.abc import Collection
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import Manifest

from ..db.among import among
from ..db.models import Evaluation, Shard, Submission, Worker
from ..db.states import ShardState
from ..queue.leases import Lease


def known_manifest(session: Session, lease: Lease) -> Manifest | None:
    """Return what this evaluator version plays the task with, from any shard that has said so."""
    found = session.scalar(
        select(Shard.manifest)
        .join(Evaluation)
        .join(Submission)
        .where(
            Evaluation.evaluator_version == lease.evaluator_version,
            Submission.track == lease.track,
            Evaluation.commitment.is_not_distinct_from(lease.commitment),
            Shard.task == lease.task,
            Shard.manifest.is_not(None),
        )
        .limit(1)
    )
    return Manifest.model_validate(found) if found is not None else None


def manifest_of(session: Session, evaluation: Evaluation, task: str) -> Manifest:
    """Return what a completed evaluation played a task with."""
    found = session.scalars(
        select(Shard.manifest).where(
            Shard.evaluation_id == evaluation.id, Shard.task == task, Shard.state == ShardState.DONE
        )
    ).first()
    return Manifest.model_validate(found)


def note_packages(session: Session, evaluation: Evaluation, lease: Lease) -> None:
    """Keep with an evaluation, which is locked, what the worker of a shard says that its policy could import."""
    packages = session.scalar(
        select(Worker.sandbox["packages"]).join(Shard, Shard.worker_id == Worker.id).where(Shard.id == lease.shard_id)
    )
    if packages is not None and packages not in evaluation.packages:
        evaluation.packages = [*evaluation.packages, packages]


def isolation_levels(session: Session, evaluations: Collection[Evaluation]) -> dict[UUID, list[str]]:
    """Return by evaluation how the policy was isolated, once for each kind of machine that ran a shard."""
    ids = [evaluation.id for evaluation in evaluations]
    levels: dict[UUID, list[str]] = {evaluation_id: [] for evaluation_id in ids}
    rows = session.execute(
        select(Shard.evaluation_id, Shard.isolation)
        .where(among(Shard.evaluation_id, ids), Shard.isolation.is_not(None))
        .distinct()
        .order_by(Shard.evaluation_id, Shard.isolation)
    )
    for evaluation_id, level in rows:
        levels[evaluation_id].append(level or "")
    return levels
