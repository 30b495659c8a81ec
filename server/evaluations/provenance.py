"""What an evaluation was made with: manifests of its shards, isolation of the policy, and packages it could import."""

from collections.abc import Collection, Mapping
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import Manifest
from vitac.evaluator.package_sets import digest_of_packages

from ..database.engine import among
from ..database.locks import lock_evaluation
from ..database.models import Evaluation, Shard, Submission
from ..database.states import WorkState
from ..queue.leases import Lease, store_packages_digest


def known_manifest(session: Session, lease: Lease) -> Manifest | None:
    """Return what this evaluator version plays the task with, from any shard of the same kind that has said so.

    A text log may be re-simulated with other settings than models are scored with. With a sensor of a team's own, from
    a shard of the same evaluation: another sensor has another mesh.
    """
    is_the_same = Evaluation.id == lease.evaluation_id if lease.sensor_sha256 else Submission.track == lease.track
    manifest = session.scalar(
        select(Shard.manifest)
        .join(Evaluation)
        .join(Submission)
        .where(
            is_the_same,
            Submission.kind == lease.submission_kind,
            Evaluation.evaluator_version == lease.evaluator_version,
            Shard.commitment == (lease.commitment or ""),
            Shard.task == lease.task,
            Shard.manifest.is_not(None),
        )
        .limit(1)
    )
    return Manifest.model_validate(manifest) if manifest is not None else None


def read_provenance(session: Session, evaluation: Evaluation, task: str, commitment: str) -> Manifest:
    """Return what an evaluation played a task with.

    Args:
        session: of the transaction.
        evaluation: of which the shards of that list are complete.
        task: name.
        commitment: of the sealed list; empty for the public one.
    """
    manifests = session.scalars(
        select(Shard.manifest).where(
            Shard.evaluation_id == evaluation.id,
            Shard.task == task,
            Shard.commitment == commitment,
            Shard.state == WorkState.DONE,
        )
    ).first()
    return Manifest.model_validate(manifests)


def note_packages(session: Session, lease: Lease, packages: Mapping[str, str]) -> None:
    """Store what the policy of a shard sees: the digest with the shard, the list with its evaluation.

    Locks the evaluation only where the list is new to it, and before the shard: call it with nothing locked.

    Args:
        session: of the transaction.
        lease: on the shard.
        packages: versions by name, as the shard's process says.

    Raises:
        LeaseLost: the shard is no longer ours.
    """
    seen = dict(packages)
    if seen not in (session.scalar(select(Evaluation.packages).where(Evaluation.id == lease.evaluation_id)) or []):
        evaluation = lock_evaluation(session, lease.evaluation_id)
        if seen not in evaluation.packages:  # Another shard may have been quicker.
            evaluation.packages = [*evaluation.packages, seen]
    store_packages_digest(session, lease, digest_of_packages(packages))


def isolation_levels(session: Session, evaluations: Collection[Evaluation]) -> dict[UUID, list[str]]:
    """Return by evaluation how the policy was isolated, once for each kind of machine that ran a shard."""
    ids = [evaluation.id for evaluation in evaluations]
    levels: dict[UUID, list[str]] = {evaluation_id: [] for evaluation_id in ids}
    if not ids:
        return levels
    rows = session.execute(
        select(Shard.evaluation_id, Shard.isolation)
        .where(among(Shard.evaluation_id, ids), Shard.isolation.is_not(None))
        .distinct()
        .order_by(Shard.evaluation_id, Shard.isolation)
    )
    for evaluation_id, level in rows:
        levels[evaluation_id].append(level or "")
    return levels
