"""All submissions of a stage as one zip, which is sent while it is written; for organizers who look at the code."""

import io
import re
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session, joinedload

from ..competitions.stages import Stage
from ..csv_text import csv_text
from ..database.models import Submission
from ..principals import Principal
from ..storage.blobs import BlobStore, StoredFileLost

INDEX_NAME = "submissions.csv"
LOST_NAME = "missing.txt"
_COLUMNS = ("team", "submission", "id", "kind", "sha256", "submitted_at", "file")
_STAMP = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True, kw_only=True)
class StageFile:
    """A submission in the zip; its file has the name `file`."""

    team: str
    submission: str
    id: str
    kind: str
    sha256: str
    submitted_at: datetime
    file: str


def list_files(session: Session, by: Principal, stage: Stage) -> list[StageFile]:
    """Return the submissions of a stage by team and time.

    Raises:
        ServiceError: not an organizer.
    """
    by.require_organizer(stage.competition)
    query = select(Submission).where(stage.submissions).options(joinedload(Submission.team))
    submissions = sorted(session.scalars(query), key=lambda one: (one.team.name_key, one.submitted_at))
    return [
        StageFile(
            team=one.team.name,
            submission=one.name,
            id=str(one.id),
            kind=one.kind.value,
            sha256=one.archive_sha256,
            submitted_at=one.submitted_at,
            file=f"{_plain(one.team.name)}/{one.submitted_at:%Y%m%d-%H%M%S}-{str(one.id)[:8]}.{_end(one)}",
        )
        for one in submissions
    ]


def stream_zip(blobs: BlobStore, files: Sequence[StageFile]) -> Iterator[bytes]:
    """Yield the bytes of a zip with an index and the uploads as they were sent; what is no longer stored is listed.

    Args:
        blobs: the file store.
        files: of the stage.
    """
    sink, lost = _Sink(), []
    with zipfile.ZipFile(sink, "w") as archive:
        archive.writestr(zipfile.ZipInfo(INDEX_NAME, _STAMP), _write_index(files))
        for file in files:
            try:
                with archive.open(zipfile.ZipInfo(file.file, _STAMP), "w", force_zip64=True) as entry:
                    for chunk in blobs.chunks(file.sha256):
                        entry.write(chunk)
                        yield sink.take()
            except StoredFileLost as error:
                lost.append(f"{file.file}: {error}\n")
        if lost:
            archive.writestr(zipfile.ZipInfo(LOST_NAME, _STAMP), "".join(lost))
    yield sink.take()


def _write_index(files: Sequence[StageFile]) -> str:
    return csv_text([_COLUMNS, *([str(getattr(file, name)) for name in _COLUMNS] for file in files)])


class _Sink(io.RawIOBase):
    """Keeps what a zip file writes until it is taken."""

    def __init__(self) -> None:
        self._written = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, content: bytes) -> int:  # type: ignore[override]
        self._written += content
        return len(content)

    def take(self) -> bytes:
        """Return what was written since the last time."""
        content = bytes(self._written)
        self._written.clear()
        return content


def _plain(name: str) -> str:
    """Return a team's name as a folder that every system takes."""
    return re.sub(r"[^\w-]+", "_", name).strip("_") or "team"


def _end(submission: Submission) -> str:
    return submission.kind.form.suffixes[0].removeprefix(".")
