"""What an evaluation was made with: the manifests that its shards have reported, and how they isolated the policy."""

from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import Manifest

from ..db.models import Evaluation, Shard, Submission
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


def isolation_levels(session: Session, evaluation: Evaluation) -> list[str]:
    """Return how the policy was isolated, once for each kind of machine that ran a shard."""
    query = select(Shard.isolation).where(Shard.evaluation_id == evaluation.id, Shard.isolation.is_not(None))
    return sorted({isolation for isolation in session.scalars(query) if isolation is not None})
