"""An upload that passed all checks; made by the checks of its kind, turned into a submission by `submissions`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vitac.evaluator.submission_kinds import SubmissionKind

from ..database.states import FileRole


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
