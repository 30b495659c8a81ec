"""The sensor of a submission, and what sensing adds; called by API and pages."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from uuid import UUID

from sqlalchemy import ColumnElement, select
from sqlalchemy.orm import Session
from vitac.evaluator.figures.figures import FiguresPart, SensorFigures, merged
from vitac.evaluator.regression import Coefficients
from vitac.evaluator.scoring.comparison import RunsDiffer, SensingGain, sensing_gain
from vitac.evaluator.tracks import Player, load_track

from ..competitions.sealing import played_track
from ..database.models import Evaluation, Submission, SubmissionFile
from ..database.states import EvaluationState, FileRole
from ..errors import not_found
from ..evaluations.history import newest_evaluation
from ..principals import Principal
from ..queue.leases import Lease
from ..views.submissions import DocumentView, EpisodeView, SensorView
from ..visibility import decide_sight, visible
from .files import find_file
from .intake import UploadedFile
from .listing import episodes


def coefficients_file(coefficients: Coefficients, lease: Lease, folder: Path) -> UploadedFile:
    """Return what is stored of what the standard estimator has learned in an evaluation; every shard learns the same.

    Args:
        coefficients: of the estimator.
        lease: on a shard that it has played.
        folder: where the file is written.
    """
    facts = {str(lease.evaluation_id): lease.sensor_sha256}
    return _written(FileRole.COEFFICIENTS, folder / "coefficients.json", coefficients.as_bytes(), facts)


def coefficients_digest(session: Session, submission_id: UUID, evaluation_id: UUID, sensor: str) -> str | None:
    """Return the digest of what the estimator has learned of a sensor in an evaluation.

    None before; or where the evaluation was played with another sensor, which this one has replaced since.

    Args:
        session: of the transaction.
        submission_id: whose sensor it is.
        evaluation_id: of the submission; another run learns again, as it plays again.
        sensor: digest of the made sensor.
    """
    return session.scalar(
        select(SubmissionFile.sha256).where(
            SubmissionFile.submission_id == submission_id,
            SubmissionFile.role == FileRole.COEFFICIENTS,
            SubmissionFile.facts[str(evaluation_id)].as_string() == sensor,
        )
    )


def is_played_by_estimator(lease: Lease) -> bool:
    """Return whether our standard estimator plays a shard, seeing or blind."""
    return _find_player(lease) is not Player.POLICY


def is_measured_by(lease: Lease) -> bool:
    """Return whether a shard measures a part of the figures of its sensor."""
    return lease.sensor_sha256 is not None and load_track(lease.track).task(lease.task).measures_figures


def has_part(session: Session, lease: Lease) -> bool:
    """Return whether the part of a shard is stored."""
    parts = _parts(lease.submission_id, lease.evaluator_version, lease.commitment)
    query = select(SubmissionFile.sha256).where(*parts, SubmissionFile.facts["shard"].as_integer() == lease.number)
    return session.scalar(query.limit(1)) is not None


def known_part(session: Session, lease: Lease) -> FiguresPart | None:
    """Return what the team's submissions with the same sensor have measured in the same shard of the track and list.

    Another team's parts are not taken: how soon figures exist would reveal that somebody else has the same sensor.
    Parts of which something could not be measured are not, either.
    """
    team = select(Submission.team_id).where(Submission.id == lease.submission_id).scalar_subquery()
    parts_known = session.scalars(
        select(SubmissionFile.facts["part"])
        .join(Submission, Submission.id == SubmissionFile.submission_id)
        .where(
            Submission.team_id == team,
            Submission.track == lease.track,
            *_measured_alike(lease.evaluator_version, lease.commitment),
            SubmissionFile.facts["shard"].as_integer() == lease.number,
            SubmissionFile.facts["sensor"].as_string() == lease.sensor_sha256,
        )
        .order_by(SubmissionFile.sha256)
    )
    parts = [FiguresPart.model_validate(part) for part in parts_known]
    return next((part for part in parts if part.problem is None), None)


def part_file(part: FiguresPart, lease: Lease, folder: Path) -> UploadedFile:
    """Return what is stored of the part of a shard.

    Args:
        part: what it has measured.
        lease: on the shard.
        folder: where the file is written.
    """
    facts = {
        "evaluator_version": lease.evaluator_version,
        "commitment": lease.commitment,
        "shard": lease.number,
        "sensor": lease.sensor_sha256,
        "part": part.model_dump(mode="json"),
    }
    content = json.dumps(facts).encode() + b"\n"  # shards that measured the same still have a file each
    return _written(FileRole.FIGURES, folder / "figures-part.json", content, facts)


def read_figures(
    session: Session, submission: Submission, evaluation: Evaluation, *, with_starts: bool = True
) -> SensorFigures | None:
    """Return the figures of a submission's sensor as far as an evaluation's evaluator has measured them on its list.

    Args:
        session: of the transaction.
        submission: whose sensor it is.
        evaluation: of the submission.
        with_starts: whether to include what was measured at starts of the list, which reveals its episodes.
    """
    stored = session.scalars(
        select(SubmissionFile.facts)
        .where(*_parts(submission.id, evaluation.evaluator_version, evaluation.commitment))
        .order_by(SubmissionFile.sha256)
    ).all()
    parts = [FiguresPart.model_validate(facts["part"]) for facts in stored]
    if not with_starts:
        parts = [part.model_copy(update={"starts": ()}) for part in parts]
    track = played_track(session, submission.track, evaluation.commitment)
    measured = next(task for task in track.tasks.values() if task.measures_figures)
    return merged(parts, [start.offset for start in measured.episode_list.starts])


def _find_player(lease: Lease) -> Player:
    """Return who plays a shard; without a sensor that is always the submission."""
    return Player.POLICY if lease.sensor_sha256 is None else load_track(lease.track).task(lease.task).player


def _written(role: FileRole, path: Path, content: bytes, facts: dict[str, Any]) -> UploadedFile:
    path.write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()
    return UploadedFile(role=role, path=path, sha256=digest, n_bytes=len(content), name=path.name, facts=facts)


def _parts(submission_id: UUID, evaluator_version: str, commitment: str | None) -> tuple[ColumnElement[bool], ...]:
    return SubmissionFile.submission_id == submission_id, *_measured_alike(evaluator_version, commitment)


def _measured_alike(evaluator_version: str, commitment: str | None) -> tuple[ColumnElement[bool], ...]:
    return (
        SubmissionFile.role == FileRole.FIGURES,
        SubmissionFile.facts["evaluator_version"].as_string() == evaluator_version,
        SubmissionFile.facts["commitment"].as_string().is_not_distinct_from(commitment),
    )


def sensor(session: Session, by: Principal, submission: Submission) -> SensorView:
    """Return the sensor of a submission that somebody may read.

    Of its figures only those without starts are shown where episodes are not.

    Raises:
        ServiceError: it has no sensor.
    """
    submission_id = submission.id
    made, described = (_file(session, submission_id, role) for role in (FileRole.SENSOR, FileRole.DOCUMENT))
    evaluation = newest_evaluation(session, submission)
    return SensorView(
        digest=made.sha256,
        **made.facts,
        document=DocumentView.from_row(described),
        coefficients_sha256=coefficients_digest(session, submission_id, evaluation.id, made.sha256),
        gain=_gain(session, by, submission),
        figures=read_figures(session, submission, evaluation, with_starts=decide_sight(by, evaluation).episodes),
    )


def document(session: Session, by: Principal, submission_id: UUID) -> DocumentView:
    """Return where the design document of a submission is stored.

    Raises:
        ServiceError: there is no such submission, or it has no document.
    """
    visible(session, by, submission_id)
    file = _file(session, submission_id, FileRole.DOCUMENT)
    return DocumentView.from_row(file)


def to_save(submission_id: UUID, document: DocumentView) -> dict[str, str]:
    """Return the headers with which a document is handed out: browsers save it, and neither show nor guess what it is.

    Args:
        submission_id: whose.
        document: as it is stored.
    """
    return {
        "Content-Type": "application/octet-stream",
        "Content-Disposition": f'attachment; filename="{submission_id}-{document.name}"',
        "X-Content-Type-Options": "nosniff",
        "Content-Security-Policy": "sandbox; default-src 'none'",
    }


def _file(session: Session, submission_id: UUID, role: FileRole) -> SubmissionFile:
    file = find_file(session, submission_id, role)
    if file is None:
        raise not_found(f"{role} of submission", submission_id)
    return file


def _gain(session: Session, by: Principal, submission: Submission) -> SensingGain | None:
    """Return the gain; None where its two runs are not over, not both played, or their episodes not shown."""
    evaluation = newest_evaluation(session, submission)
    if evaluation.state is not EvaluationState.COMPLETED or not decide_sight(by, evaluation).episodes:
        return None
    players = {task.player: name for name, task in load_track(submission.track).tasks.items()}
    ends = episodes(session, by, submission.id)
    try:
        return sensing_gain(_select_task(ends, players[Player.ESTIMATOR]), _select_task(ends, players[Player.BLIND]))
    except RunsDiffer:
        return None


def _select_task(ends: Sequence[EpisodeView], task: str) -> list[EpisodeView]:
    return [end for end in ends if end.task == task]
