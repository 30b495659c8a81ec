"""From an uploaded body to a checked, stored submission; nothing is left behind when any step refuses.

The body is received by the event loop, the checks run in a thread. Nothing of the archive is imported or unpickled.
"""

import asyncio
import hashlib
import shutil
import tempfile
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from vitac.evaluator.archive import unpack
from vitac.evaluator.archive_names import ArchiveRejected
from vitac.evaluator.submission import ManifestRejected, SubmissionManifest, load_manifest, submission_digest
from vitac.evaluator.tracks import load_track
from vitac.server.db.states import SubmissionKind
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.services import Services
from vitac.server.settings import Settings
from vitac.server.submissions import CheckedUpload

_ARCHIVE_NAME = "archive.zip"
_UNPACKED_NAME = "unpacked"


@dataclass(frozen=True, kw_only=True)
class ReceivedFile:
    """A body on disk."""

    path: Path
    sha256: str
    n_bytes: int


@contextmanager
def upload_folder(settings: Settings) -> Iterator[Path]:
    """A private folder for one upload, gone with all it holds when the block is left."""
    settings.scratch_dir.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix="upload-", dir=settings.scratch_dir))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def check_announced_size(n_bytes: int | None, settings: Settings) -> None:
    """Refuses a body that is too large before the first byte is read.

    Raises:
        ServiceError: larger than the limit, which the problem names.
    """
    if n_bytes is not None and n_bytes > settings.limits.archive_packed_bytes:
        raise _too_large(settings, f"{n_bytes} bytes were announced")


async def receive(
    body: AsyncIterator[bytes], folder: Path, settings: Settings, *, announced_bytes: int | None
) -> ReceivedFile:
    """Writes a body to disk while counting and hashing it.

    Raises:
        ServiceError: larger than the limit, shorter than announced, silent for too long, or empty.
    """
    path = folder / _ARCHIVE_NAME
    digest, n_bytes = hashlib.sha256(), 0
    with path.open("xb") as file:
        async for chunk in _without_silence(body, settings.upload_silence_s):
            n_bytes += len(chunk)
            if n_bytes > settings.limits.archive_packed_bytes:
                raise _too_large(settings, "more came")
            digest.update(chunk)
            file.write(chunk)
    if n_bytes == 0 or (announced_bytes is not None and n_bytes != announced_bytes):
        expected = "at least one" if announced_bytes is None else str(announced_bytes)
        raise truncated(f"{n_bytes} bytes came, expected {expected}")
    return ReceivedFile(path=path, sha256=digest.hexdigest(), n_bytes=n_bytes)


def accept(services: Services, received: ReceivedFile, *, track: str | None) -> CheckedUpload:
    """Checks a received archive by all rules and stores it. Slow: call it in a thread.

    Args:
        services: of this process.
        received: the body.
        track: what the request named; the manifest must name the same.

    Raises:
        ServiceError: a rule is broken, or the file store is away.
    """
    manifest, digest = _inspect(received.path, services.settings)
    if track is not None and manifest.track != track:
        raise ServiceError(
            ProblemCode.MANIFEST_REJECTED,
            f"The request is for {track!r}, but submission.yaml says track {manifest.track!r}. Make them agree.",
        )
    services.blobs.put(received.path, received.sha256)
    return CheckedUpload(
        kind=SubmissionKind.MODEL,
        track=manifest.track,
        tasks=tuple(task for task in load_track(manifest.track).tasks if task in manifest.tasks),
        name=manifest.name,
        digest=digest,
        archive_sha256=received.sha256,
        archive_bytes=received.n_bytes,
        manifest=manifest.model_dump(mode="json"),
    )


def check_digest(received: ReceivedFile, claimed: str | None) -> None:
    """Compares the digest that the client gave with what came.

    Raises:
        ServiceError: they differ, so the body was damaged on its way.
    """
    if claimed is not None and claimed.lower() != received.sha256:
        raise ServiceError(
            ProblemCode.DIGEST_MISMATCH,
            f"SHA-256 {claimed[:80]} was announced, {received.n_bytes} bytes with {received.sha256} came. Send again.",
            received_sha256=received.sha256,
        )


def truncated(what: str) -> ServiceError:
    """The refusal of a body that ended early."""
    return ServiceError(
        ProblemCode.UPLOAD_TRUNCATED, f"The upload ended early: {what}. Nothing was kept; send it again."
    )


def _inspect(archive: Path, settings: Settings) -> tuple[SubmissionManifest, str]:
    try:
        folder = unpack(archive, archive.with_name(_UNPACKED_NAME), settings.limits)
        return load_manifest(folder), submission_digest(folder, settings.limits)
    except ArchiveRejected as error:
        raise ServiceError(ProblemCode.ARCHIVE_REJECTED, error.message, reason=error.code.value) from error
    except ManifestRejected as error:
        raise ServiceError(ProblemCode.MANIFEST_REJECTED, str(error)) from error


def _too_large(settings: Settings, what: str) -> ServiceError:
    limit = settings.limits.archive_packed_bytes
    return ServiceError(
        ProblemCode.UPLOAD_TOO_LARGE,
        f"An archive may have at most {limit} bytes; {what}. Make it smaller.",
        limit_bytes=limit,
    )


async def _without_silence(body: AsyncIterator[bytes], limit_s: float) -> AsyncIterator[bytes]:
    """The chunks of a body as long as they keep coming."""
    while True:
        try:
            chunk = await asyncio.wait_for(anext(body), limit_s)
        except StopAsyncIteration:
            return
        except TimeoutError:
            raise truncated(f"nothing came for {limit_s:g} s") from None
        if chunk:
            yield chunk
