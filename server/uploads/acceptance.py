"""Checks a received body by all rules of its kind and stores it; called by the upload route, in a thread.

Nothing of an archive is imported or unpickled, nothing of a log is simulated.
"""

from collections.abc import Iterator
from contextlib import contextmanager, suppress

from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import Track

from ..errors import ProblemCode, ServiceError
from ..services import Services
from ..storage import stored_files
from ..tracks import load_known_track
from .checked_upload import CheckedUpload
from .intake import ReceivedFile
from .kinds import SERVED_KINDS


def check_kind(kind: SubmissionKind, track: Track) -> None:
    """Refuse what a track does not take.

    Raises:
        ServiceError: with the kinds that it takes.
    """
    if kind not in track.accepts:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_SUBMISSION_KIND,
            f"{track.name} takes {', '.join(track.accepts)}, got {kind}.",
            supported=list(track.accepts),
        )


def accept(
    services: Services, received: ReceivedFile, *, kind: SubmissionKind, track: str | None, owner: str
) -> CheckedUpload:
    """Check a body and store it.

    Args:
        services: of this process.
        received: the body.
        kind: what it must be.
        track: what the request named; the body must name the same.
        owner: the team whose submission it becomes; a log must name no other.

    Raises:
        ServiceError: a rule is broken, or the file store is unavailable.
    """
    upload = SERVED_KINDS[kind].check(received, owner, services.settings)
    if track is not None and upload.track != track:
        raise _other_track(upload, track)
    check_kind(kind, load_known_track(upload.track))
    paths = {received.sha256: received.path} | {file.sha256: file.path for file in upload.files}
    for digest, path in paths.items():
        with services.database.transaction() as session:
            stored_files.store(session, services.blobs, path, digest)
    return upload


@contextmanager
def removed_if_refused(services: Services, upload: CheckedUpload) -> Iterator[None]:
    """Remove what was stored of an upload that the block refuses: those refused again and again would fill the disk."""
    try:
        yield
    except ServiceError:
        remove_unnamed(services, upload)
        raise


def remove_unnamed(services: Services, upload: CheckedUpload) -> None:
    """Remove what was stored of an upload and no submission names; what cannot be removed now, housekeeping removes."""
    with suppress(ServiceError):
        stored_files.remove_unnamed(services.database, services.blobs, upload.digests)


def _other_track(upload: CheckedUpload, track: str) -> ServiceError:
    code, says = SERVED_KINDS[upload.kind].names_track
    return ServiceError(code, f"The request is for {track!r}, but {says} {upload.track!r}. Make them agree.")
