"""Checks a received body by all rules of its kind and stores it; called by the upload route, in a thread.

Nothing of an archive is imported or unpickled, nothing of a log is simulated.
"""

from vitac.evaluator.submission.archive import unpack
from vitac.evaluator.submission.manifest import ManifestRejected, load_manifest, submission_digest
from vitac.evaluator.submission.names import ArchiveRejected
from vitac.evaluator.tracks import Accepted, Track
from vitac.server.db.states import SubmissionKind
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.services import Services
from vitac.server.settings import Settings
from vitac.server.tracks import load_known_track
from vitac.server.uploads.checked_upload import CheckedUpload
from vitac.server.uploads.intake import ReceivedFile
from vitac.server.uploads.logs import check_log
from vitac.server.uploads.text_logs import check_text_log

_UNPACKED_NAME = "unpacked"


def check_kind(kind: SubmissionKind, track: Track) -> None:
    """Refuses what a track does not take.

    Raises:
        ServiceError: with the kinds that it takes.
    """
    if Accepted(kind.value) not in track.accepts:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_SUBMISSION_KIND,
            f"{track.name} takes {', '.join(track.accepts)}; came {kind}.",
            supported=list(track.accepts),
        )


def accept(
    services: Services, received: ReceivedFile, *, kind: SubmissionKind, track: str | None, owner: str
) -> CheckedUpload:
    """Check a body and stores it.

    Args:
        services: of this process.
        received: the body.
        kind: what it must be.
        track: what the request named; the body must name the same.
        owner: the team whose submission it becomes; a log must name no other.

    Raises:
        ServiceError: a rule is broken, or the file store is away.
    """
    upload = _checked(received, services.settings, kind, owner)
    if track is not None and upload.track != track:
        raise _other_track(upload, track)
    check_kind(kind, load_known_track(upload.track))
    services.blobs.put(received.path, received.sha256)
    return upload


def _checked(received: ReceivedFile, settings: Settings, kind: SubmissionKind, owner: str) -> CheckedUpload:
    if kind is SubmissionKind.LOG:
        return check_log(received, owner, settings.log_bytes)
    if kind is SubmissionKind.TEXT_LOG:
        return check_text_log(received, owner, settings.log_bytes)
    return _check_model(received, settings)


def _check_model(received: ReceivedFile, settings: Settings) -> CheckedUpload:
    try:
        folder = unpack(received.path, received.path.with_name(_UNPACKED_NAME), settings.limits)
        manifest, digest = load_manifest(folder), submission_digest(folder, settings.limits)
    except ArchiveRejected as error:
        raise ServiceError(ProblemCode.ARCHIVE_REJECTED, error.message, reason=error.code.value) from error
    except ManifestRejected as error:
        raise ServiceError(ProblemCode.MANIFEST_REJECTED, str(error)) from error
    return CheckedUpload(
        kind=SubmissionKind.MODEL,
        track=manifest.track,
        tasks=tuple(task for task in load_known_track(manifest.track).tasks if task in manifest.tasks),
        name=manifest.name,
        digest=digest,
        archive_sha256=received.sha256,
        archive_bytes=received.n_bytes,
        manifest=manifest.model_dump(mode="json"),
    )


def _other_track(upload: CheckedUpload, track: str) -> ServiceError:
    if upload.kind is SubmissionKind.MODEL:
        code, says = ProblemCode.MANIFEST_REJECTED, "submission.yaml says track"
    else:
        code, says = ProblemCode.LOG_REJECTED, "the log is of"
    return ServiceError(code, f"The request is for {track!r}, but {says} {upload.track!r}. Make them agree.")
