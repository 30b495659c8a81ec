"""What is said of an upload before it arrives, what holds of it whatever it contains, and what it is once checked."""

import asyncio
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
from ..storage.blobs import Piece
from ..storage.scratch import scratch_folder

FILE_NAME = "upload"
UPLOAD_FOLDER = "upload"
"""First word of the names of folders for uploads, in the scratch folder."""


SHA256 = re.compile("[0-9a-f]{64}")


@dataclass(frozen=True, kw_only=True)
class AnnouncedUpload:
    """What a client says of an upload before it sends the first byte.

    Attributes:
        kind: what the body is.
        track: that the body must name; None: whatever it names.
        competition: name of the competition; None: the one that takes submissions to the track.
        team: for an organizer: whose submission it becomes.
        again: run all episodes again, including stored ones.
        file_name: as the client names it; None if the client did not send it.
        total_bytes: length of the body; None if the client did not send it.
        sha256: digest of the body, hex; None if the client did not send it.
    """

    kind: SubmissionKind
    track: str | None = None
    competition: str | None = None
    team: str | None = None
    again: bool = False
    file_name: str | None = None
    total_bytes: int | None = None
    sha256: str | None = None


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


def check_announced(announced: AnnouncedUpload, limit_bytes: int) -> None:
    """Refuse what cannot be an upload before the first byte of it is read.

    Args:
        announced: what the client says.
        limit_bytes: largest body of its kind.

    Raises:
        ServiceError: it is empty or larger than the limit, which the problem names, or its digest is none.
    """
    if announced.total_bytes == 0:
        raise empty()
    if announced.total_bytes is not None and announced.total_bytes > limit_bytes:
        raise too_large(limit_bytes, f"{announced.total_bytes} were announced")
    if announced.sha256 is not None and not SHA256.fullmatch(announced.sha256):
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Expected the SHA-256 as 64 hex digits, got {announced.sha256!r:.80}."
        )


def check_digest(received: ReceivedFile, claimed: str | None) -> None:
    """Compare the digest that the client gave with what was received.

    Raises:
        ServiceError: they differ, so the body was damaged on its way.
    """
    if claimed is not None and claimed != received.sha256:
        raise ServiceError(
            ProblemCode.DIGEST_MISMATCH,
            f"Expected SHA-256 {claimed}, got {received.n_bytes} bytes with {received.sha256}. Send again.",
            received_sha256=received.sha256,
        )


def truncated(what: str) -> ServiceError:
    """Return the refusal of a body that ended early."""
    return ServiceError(
        ProblemCode.UPLOAD_TRUNCATED,
        f"The upload ended early: {what}. Send it again; a resumable upload continues where it ended.",
    )


def empty() -> ServiceError:
    """Return the refusal of a body without a byte."""
    message = "The upload is empty, expected at least one byte. Check the file, and send it again."
    return ServiceError(ProblemCode.UPLOAD_TRUNCATED, message)


def too_large(limit_bytes: int, what: str) -> ServiceError:
    """Return the refusal of a body that is larger than its kind's limit, or than was announced."""
    return ServiceError(
        ProblemCode.UPLOAD_TOO_LARGE,
        f"This upload may have at most {limit_bytes} bytes; {what}. Make it smaller.",
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
    match = _FORM.fullmatch(name[:MAX_CHARACTERS]) if name is not None else None
    if match is None:
        return
    _require(name, "team", match["team"], team, agrees=_folded(match["team"]) == _folded(team))
    if stage is None:
        return
    named, folder = f"Track_{match['track']}", load_track(stage.track).folder
    _require(name, "track", named, folder, agrees=named.casefold() == folder.casefold())
    if not stage.is_practice:
        _require(name, "stage", match["stage"], stage.name, agrees=match["stage"].casefold() == stage.name.casefold())


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
        pieces: in which an image is stored, so that layers that it shares with others are stored once.
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
    pieces: tuple[Piece, ...] = ()

    @property
    def digests(self) -> frozenset[str]:
        """Digests of all files that are stored of it."""
        return frozenset({self.archive_sha256, *(file.sha256 for file in self.files)})
