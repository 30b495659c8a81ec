"""Checks an uploaded model: the archive's rules and the submission manifest; called by `kinds`."""

import hashlib
from pathlib import Path

from vitac.evaluator.sensors.manifest import SensorRejected
from vitac.evaluator.sensors.package import design_document
from vitac.evaluator.submission.archive import unpack
from vitac.evaluator.submission.likeness import make_sketch
from vitac.evaluator.submission.manifest import ManifestRejected, load_unpacked_manifest
from vitac.evaluator.submission.names import ArchiveRejected
from vitac.evaluator.submission.sources import submission_digest
from vitac.evaluator.submission_kinds import SubmissionKind

from ..database.states import FileRole
from ..errors import ProblemCode, ServiceError
from ..settings import Settings
from ..tracks import load_known_track
from .checked_upload import CheckedUpload, UploadedFile
from .contents import read_contents
from .intake import ReceivedFile

_UNPACKED_NAME = "unpacked"
_DOCUMENT_NAME = "design-document"


def check_model(received: ReceivedFile, owner: str, settings: Settings) -> CheckedUpload:  # noqa: ARG001 - as all checks
    """Unpack an archive beside itself and read its manifest; nothing of it is imported.

    Args:
        received: the body.
        owner: the team whose submission it becomes, which a model does not name.
        settings: limits on archives.

    Raises:
        ServiceError: the archive or its manifest breaks a rule.
    """
    try:
        folder = unpack(received.path, received.path.with_name(_UNPACKED_NAME), settings.limits)
        manifest, digest = load_unpacked_manifest(folder), submission_digest(folder, settings.limits)
    except ArchiveRejected as error:
        raise ServiceError(ProblemCode.ARCHIVE_REJECTED, error.message, reason=error.code.value) from error
    except ManifestRejected as error:
        raise ServiceError(ProblemCode.MANIFEST_REJECTED, str(error)) from error
    track = load_known_track(manifest.track)
    return CheckedUpload(
        kind=SubmissionKind.MODEL,
        track=manifest.track,
        tasks=track.list_played_tasks(manifest.tasks),
        name=manifest.name,
        digest=digest,
        archive_sha256=received.sha256,
        archive_bytes=received.n_bytes,
        manifest=manifest.model_dump(mode="json"),
        archive_sketch=make_sketch(folder).to_bytes(),
        contents=read_contents(folder).model_dump(),
        files=(_take_document(folder),) if track.has_sensor else (),
    )


def _take_document(folder: Path) -> UploadedFile:
    """Return the design document of an unpacked submission.

    Raises:
        ServiceError: there is none, or several.
    """
    try:
        document = design_document(folder)
    except SensorRejected as error:
        raise ServiceError(ProblemCode.SENSOR_REJECTED, str(error)) from error
    with document.path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return UploadedFile(
        role=FileRole.DOCUMENT,
        path=document.path,
        sha256=sha256,
        n_bytes=document.n_bytes,
        name=f"{_DOCUMENT_NAME}{document.suffix}",
    )
