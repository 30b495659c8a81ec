"""Receives an uploaded body into a folder of its own, and what it is once it passed all checks.

Called by the upload routes, in the event loop; nothing is left behind when anything refuses it.
"""

import asyncio
import hashlib
import re
import unicodedata
from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import load_track

from ..competitions.stages import Stage
from ..database.states import FileRole
from ..errors import ProblemCode, ServiceError
from ..settings import Settings
from ..storage.scratch import scratch_folder

FILE_NAME = "upload"
UPLOAD_FOLDER = "upload"
"""First word of the names of folders for uploads, in the scratch folder."""


@dataclass(frozen=True, kw_only=True)
class ReceivedFile:
    """A body on disk."""

    path: Path
    sha256: str
    n_bytes: int


@contextmanager
def upload_folder(settings: Settings) -> Iterator[Path]:
    """Return a private folder for one upload, gone with all it holds when the block is left."""
    with scratch_folder(settings.scratch_dir, UPLOAD_FOLDER) as folder:
        yield folder


def check_announced_size(n_bytes: int | None, limit_bytes: int) -> None:
    """Refuse a body that is too large before the first byte is read.

    Raises:
        ServiceError: larger than the limit, which the problem names.
    """
    if n_bytes is not None and n_bytes > limit_bytes:
        raise _too_large(limit_bytes, f"{n_bytes} bytes were announced")


async def receive(
    body: AsyncIterator[bytes], folder: Path, *, limit_bytes: int, idle_timeout_s: float, announced_bytes: int | None
) -> ReceivedFile:
    """Write a body to disk while counting and hashing it.

    Raises:
        ServiceError: larger than the limit, shorter than announced, idle for too long, or empty.
    """
    path = folder / FILE_NAME
    digest, n_bytes = hashlib.sha256(), 0
    with path.open("xb") as file:
        async for chunk in limit_idle_time(body, idle_timeout_s):
            n_bytes += len(chunk)
            if n_bytes > limit_bytes:
                raise _too_large(limit_bytes, "more were sent")
            digest.update(chunk)
            file.write(chunk)
    if announced_bytes is not None and n_bytes != announced_bytes:
        raise truncated(f"expected {announced_bytes}, got {n_bytes} bytes")
    if n_bytes == 0:
        message = "The upload is empty, expected at least one byte. Check the file, and send it again."
        raise ServiceError(ProblemCode.UPLOAD_TRUNCATED, message)
    return ReceivedFile(path=path, sha256=digest.hexdigest(), n_bytes=n_bytes)


def check_digest(received: ReceivedFile, claimed: str | None) -> None:
    """Compare the digest that the client gave with what was received.

    Raises:
        ServiceError: they differ, so the body was damaged on its way.
    """
    if claimed is not None and claimed.lower() != received.sha256:
        raise ServiceError(
            ProblemCode.DIGEST_MISMATCH,
            f"Expected SHA-256 {claimed[:80]}, got {received.n_bytes} bytes with {received.sha256}. Send again.",
            received_sha256=received.sha256,
        )


def truncated(what: str) -> ServiceError:
    """Return the refusal of a body that ended early."""
    return ServiceError(
        ProblemCode.UPLOAD_TRUNCATED,
        f"The upload ended early: {what}. Send it again; a resumable upload continues where it ended.",
    )


def _too_large(limit_bytes: int, what: str) -> ServiceError:
    return ServiceError(
        ProblemCode.UPLOAD_TOO_LARGE,
        f"An upload of this kind may have at most {limit_bytes} bytes; {what}. Make it smaller.",
        limit_bytes=limit_bytes,
    )


async def limit_idle_time(body: AsyncIterator[bytes], limit_s: float) -> AsyncIterator[bytes]:
    """Yield the chunks of a body as long as they keep coming.

    Raises:
        ServiceError: none arrived for too long.
    """
    while True:
        try:
            chunk = await asyncio.wait_for(anext(body), limit_s)
        except StopAsyncIteration:
            return
        except TimeoutError:
            raise truncated(f"nothing was sent for {limit_s:g} s") from None
        if chunk:
            yield chunk


MAX_CHARACTERS = 255
"""A longer name is none that a file can have."""
_FORM = re.compile(
    r"(?P<team>.+)-Track_(?P<track>\d+)-(?P<stage>stage\d+)-result(?![^\W_]).*", re.IGNORECASE | re.DOTALL
)
"""`teamname-Track_1-stage1-result` and whatever follows, as the organizers of 2025 asked for it."""


def check_file_name(name: str | None, *, team: str, stage: Stage | None = None) -> None:
    """Refuse a file whose name says another team, track or stage than it is uploaded for.

    Args:
        name: of the file; None if the client did not send it.
        team: whose submission it becomes.
        stage: to which it is submitted; None: not known yet.

    Raises:
        ServiceError: file_name_mismatch.
    """
    found = _FORM.fullmatch(name[:MAX_CHARACTERS]) if name is not None else None
    if found is None:
        return
    _require(name, "team", found["team"], team, agrees=_folded(found["team"]) == _folded(team))
    if stage is None:
        return
    named, folder = f"Track_{found['track']}", load_track(stage.track).folder
    _require(name, "track", named, folder, agrees=named.casefold() == folder.casefold())
    if not stage.is_practice:
        _require(name, "stage", found["stage"], stage.name, agrees=found["stage"].casefold() == stage.name.casefold())


def _require(name: str | None, what: str, named: str, expected: str, *, agrees: bool) -> None:
    if not agrees:
        raise ServiceError(
            ProblemCode.FILE_NAME_MISMATCH,
            f"The file's name {name!r:.120} says the {what} {named!r:.80}, expected {expected!r}. Rename the file, or "
            f"upload it as that {what}'s.",
            part=what,
        )


def _folded(name: str) -> str:
    """Return a team's name as it may be written in a file's name: blanks, _ and - are alike, and so are all cases."""
    return re.sub(r"[\s_-]+", " ", unicodedata.normalize("NFKC", name)).strip().casefold()


@dataclass(frozen=True, kw_only=True)
class UploadedFile:
    """A file that is stored beside an upload.

    Attributes:
        role: what it is.
        path: where it lies until it is stored.
        sha256: of its content.
        n_bytes: its size.
        name: under which it is handed out.
        facts: what is shown of it.
    """

    role: FileRole
    path: Path
    sha256: str
    n_bytes: int
    name: str
    facts: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class CheckedUpload:
    """An upload that passed all checks and is stored.

    Attributes:
        files: what is stored beside it.
        file_name: as the client names it; None if the client did not send it.
        archive_sketch: what a model's archive is compared by.
        contents: what is in a model's archive, as JSON (`ArchiveContents`).
    """

    kind: SubmissionKind
    track: str
    tasks: tuple[str, ...]
    name: str
    digest: str
    archive_sha256: str
    archive_bytes: int
    manifest: dict[str, Any]
    files: tuple[UploadedFile, ...] = ()
    file_name: str | None = None
    archive_sketch: bytes | None = None
    contents: dict[str, Any] | None = None

    @property
    def digests(self) -> frozenset[str]:
        """Digests of all files that are stored of it."""
        return frozenset({self.archive_sha256, *(file.sha256 for file in self.files)})
