"""The layout of a backup: a tar file with `backup.json`, the database's dump, and one file for each blob."""

import hashlib
import json
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from io import BytesIO
from pathlib import Path
from typing import IO, Final, Literal, Self

from pydantic import ValidationError
from vitac.errors import VitacError
from vitac.evaluator.strict_model import StrictModel, Word, explain

DESCRIPTION_NAME: Final = "backup.json"
DUMP_NAME: Final = "database.dump"
BLOB_FOLDER: Final = "blobs"
FORMAT: Final = 1
_COPY_BYTES = 1 << 20


class BackupRejected(VitacError):
    """A file is no complete backup of this service, or of a newer version; nothing was changed."""


class BackupDescription(StrictModel):
    """What a backup holds, written as its first member."""

    format: Literal[1] = FORMAT
    made_at: datetime
    release: str
    """Version of the package that wrote it."""
    schema_revision: str
    dump_sha256: str
    blobs: tuple[str, ...]
    """SHA-256 of every uploaded file."""
    track_files: dict[Word, str] | None = None
    """Content of the organizers' own track files, by their names without `.yaml`; null in a backup of a release that
    did not keep them."""


class BackupWriter:
    """Writes the members of a backup."""

    def __init__(self, tar: tarfile.TarFile) -> None:
        self._tar = tar

    def describe(self, description: BackupDescription) -> None:
        """Write the description; first of all."""
        content = description.model_dump_json(indent=1).encode()
        member = tarfile.TarInfo(DESCRIPTION_NAME)
        member.size = len(content)
        self._tar.addfile(member, BytesIO(content))

    def add(self, name: str, path: Path) -> None:
        """Copy a file into the backup."""
        member = tarfile.TarInfo(name)
        member.size = path.stat().st_size
        with path.open("rb") as file:
            self._tar.addfile(member, file)


class BackupReader:
    """Reads the members of a backup, checking each against the description.

    Raises:
        BackupRejected: it is not a backup, or not a whole one.
    """

    def __init__(self, tar: tarfile.TarFile) -> None:
        self._tar = tar
        try:
            content = json.loads(self._open(DESCRIPTION_NAME).read(64 << 20))
        except ValueError as error:
            raise BackupRejected(f"{DESCRIPTION_NAME} cannot be read: {error}. Expected a whole backup.") from error
        _refuse_newer(content)
        try:
            self.description = BackupDescription.model_validate(content)
        except ValidationError as error:
            raise BackupRejected(f"{DESCRIPTION_NAME}: {explain(BackupDescription, error)}") from error

    @classmethod
    @contextmanager
    def opened(cls, path: Path) -> Iterator[Self]:
        """Open a backup for reading."""
        try:
            with tarfile.open(path, "r:") as tar:
                yield cls(tar)
        except tarfile.TarError as error:
            raise BackupRejected(
                f"{path} is not a complete backup: {error}. Expected a file of `vitac admin backup`."
            ) from error

    def check(self) -> None:
        """Read everything once.

        Raises:
            BackupRejected: a member is missing or was altered.
        """
        self._copy_checked(DUMP_NAME, self.description.dump_sha256, None)
        for sha256 in self.description.blobs:
            self._copy_checked(f"{BLOB_FOLDER}/{sha256}", sha256, None)

    def extract_dump(self, destination: Path) -> None:
        """Write the database's dump to a file."""
        with destination.open("xb") as file:
            self._copy_checked(DUMP_NAME, self.description.dump_sha256, file)

    def extract_blob(self, sha256: str, destination: Path) -> None:
        """Write an uploaded file to a path."""
        with destination.open("xb") as file:
            self._copy_checked(f"{BLOB_FOLDER}/{sha256}", sha256, file)

    def _open(self, name: str) -> IO[bytes]:
        try:
            member = self._tar.extractfile(name)
        except KeyError:
            member = None
        if member is None:
            raise BackupRejected(f"The backup has no file {name}; it is incomplete.")
        return member

    def _copy_checked(self, name: str, sha256: str, destination: IO[bytes] | None) -> None:
        digest = hashlib.sha256()
        with self._open(name) as source:
            while chunk := source.read(_COPY_BYTES):
                digest.update(chunk)
                if destination is not None:
                    destination.write(chunk)
        if digest.hexdigest() != sha256:
            raise BackupRejected(f"{name} was altered: expected SHA-256 {sha256}, got {digest.hexdigest()}.")


def _refuse_newer(content: object) -> None:
    """Refuse what a newer release has written, before the keys that it may have added are read."""
    written = content.get("format") if isinstance(content, dict) else None
    if isinstance(written, int) and written > FORMAT:
        release = content.get("release") if isinstance(content, dict) else None
        raise BackupRejected(
            f"This backup has format {written}, written by release {release!s:.40}; this release reads format "
            f"{FORMAT}. Restore it with that release or a newer one."
        )
