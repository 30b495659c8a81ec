"""What workers learn of a submission's sensor: the estimator's coefficients, and parts of its figures."""

import hashlib
from pathlib import Path
from typing import Any
from uuid import UUID

from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session
from vitac.evaluator.estimator.regression import Coefficients
from vitac.evaluator.figures.figures import FiguresPart, SensorFigures, merged
from vitac.evaluator.tracks import Player, load_track

from ..db.models import Evaluation, Submission, SubmissionFile
from ..db.states import FileRole
from ..queue.leases import Lease
from ..uploads.checked_upload import UploadedFile


def coefficients_file(coefficients: Coefficients, folder: Path) -> UploadedFile:
    """Return what is stored of what the standard estimator has learned; every shard learns the same.

    Args:
        coefficients: of the estimator.
        folder: where the file is written.
    """
    return _written(FileRole.COEFFICIENTS, folder / "coefficients.json", coefficients.as_bytes(), {})


def is_measured_by(lease: Lease) -> bool:
    """Return whether a shard measures a part of the figures: each of the blind run of a sensor does."""
    if lease.sensor_sha256 is None:
        return False
    return load_track(lease.track).tasks[lease.task].player is Player.BLIND


def has_part(session: Session, lease: Lease) -> bool:
    """Return whether the part of a shard is stored."""
    parts = _parts(lease.submission_id, lease.evaluator_version)
    found = select(SubmissionFile.sha256).where(*parts, SubmissionFile.facts["shard"].as_integer() == lease.number)
    return session.scalar(found.limit(1)) is not None


def part_file(part: FiguresPart, lease: Lease, folder: Path) -> UploadedFile:
    """Return what is stored of the part of a shard.

    Args:
        part: what it has measured.
        lease: on the shard.
        folder: where the file is written.
    """
    facts = {
        "evaluator_version": lease.evaluator_version,
        "shard": lease.number,
        "part": part.model_dump(mode="json"),
    }
    content = part.model_dump_json().encode() + b"\n"
    return _written(FileRole.FIGURES, folder / "figures-part.json", content, facts)


def figures_of(session: Session, submission: Submission, evaluation: Evaluation) -> SensorFigures | None:
    """Return the figures of a submission's sensor as far as the evaluator of an evaluation has measured them."""
    parts = session.scalars(
        select(SubmissionFile.facts)
        .where(*_parts(submission.id, evaluation.evaluator_version))
        .order_by(SubmissionFile.sha256)
    ).all()
    blind = next(task for task in load_track(submission.track).tasks.values() if task.player is Player.BLIND)
    offsets = [start.offset for start in blind.episode_list.starts]
    return merged((FiguresPart.model_validate(facts["part"]) for facts in parts), offsets)


def _written(role: FileRole, path: Path, content: bytes, facts: dict[str, Any]) -> UploadedFile:
    path.write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()
    return UploadedFile(role=role, path=path, sha256=digest, n_bytes=len(content), name=path.name, facts=facts)


def _parts(submission_id: UUID, evaluator_version: str) -> tuple[ColumnElement[bool], ...]:
    return (
        SubmissionFile.submission_id == submission_id,
        SubmissionFile.role == FileRole.FIGURES,
        SubmissionFile.facts["evaluator_version"].as_string() == evaluator_version,
    )
