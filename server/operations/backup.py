"""Backups: one archive of database and files, made while the service runs, and restored into an empty one."""

import hashlib
import json
import os
import tarfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import IO, Final, Literal, Self

from pydantic import TypeAdapter, ValidationError
from sqlalchemy import Connection, NullPool, create_engine, func, select, text
from sqlalchemy.orm import Session
from vitac.errors import VitacError
from vitac.evaluator.strict_model import DocumentRejected, StrictModel, Word, explain
from vitac.evaluator.tracks.registry import TRACKS_FOLDER_VARIABLE

from ..audit import record
from ..database import binaries
from ..database.engine import sqlalchemy_url
from ..database.locks import AdvisoryLock, wait_for_lock
from ..database.models import ApiToken, PartialUpload, Submission, Team, UploadPart, Worker
from ..database.schema import installed_revision, knows_revision, upgrade
from ..principals import CONSOLE
from ..queue.workers import workers_alive
from ..services import Services
from ..settings import Settings
from ..storage.scratch import new_file, scratch_folder
from ..submissions.files import stored_digests

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


_NAME = TypeAdapter[str](Word)


def own_track_files() -> dict[str, str]:
    """Return the content of each file in the folder that VITAC_TRACKS_DIR names, by its name without `.yaml`.

    Raises:
        DocumentRejected: one has a name that no track may have, is not text, or cannot be read.
    """
    folder = os.environ.get(TRACKS_FOLDER_VARIABLE)
    if not folder:
        return {}
    return dict(map(_read, sorted(Path(folder).glob("*.yaml"))))


def _read(path: Path) -> tuple[str, str]:
    try:
        # As bytes: the evaluator's version counts those, and reading text would change the ends of lines.
        return _NAME.validate_python(path.stem), path.read_bytes().decode("utf-8")
    except OSError as error:
        raise DocumentRejected(f"{str(path)!r} cannot be read: {error.strerror}.") from error
    except ValueError as error:
        raise DocumentRejected(
            f"{str(path)!r} is no track file: expected text in UTF-8, and a name of at most 100 letters, digits and "
            "any of . _ + : - without spaces. Rename, correct or remove it."
        ) from error


def missing_track_files(files: Mapping[str, str] | None) -> Mapping[Path, str]:
    """Return where those of a backup belong that are not there yet, with their content.

    Args:
        files: of the backup; None where it is of a release that did not keep them: the folder is taken as it is.

    Raises:
        BackupRejected: no folder is named for them, another file has the place of one, or there are further ones.
        DocumentRejected: as `own_track_files`.
    """
    if files is None:
        return {}
    folder = os.environ.get(TRACKS_FOLDER_VARIABLE)
    if files and not folder:
        raise BackupRejected(
            f"The backup has track files of its own ({', '.join(files)}), expected a folder for them; name one in "
            f"{TRACKS_FOLDER_VARIABLE}, the same for server and workers."
        )
    present = own_track_files()
    for name in files.keys() & present.keys():
        if files[name] != present[name]:
            raise BackupRejected(
                f"The track file {name}.yaml in {folder} is another one than the backup's; name another folder in "
                f"{TRACKS_FOLDER_VARIABLE}."
            )
    if further := ", ".join(f"{name}.yaml" for name in sorted(present.keys() - files.keys())):
        raise BackupRejected(
            f"Expected only track files of the backup in {folder}, got {further} too: with them all results would be "
            "of another evaluator version. Move them away for the restore."
        )
    return {Path(folder or "") / f"{name}.yaml": files[name] for name in files.keys() - present.keys()}


def put_back(files: Mapping[Path, str]) -> None:
    """Write the files of a backup that are missing.

    Raises:
        BackupRejected: the folder cannot be written.
    """
    try:
        for path, content in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            draft = path.with_name("unfinished")  # killed here, the file is missing still
            draft.write_bytes(content.encode("utf-8"))
            draft.replace(path)
    except OSError as error:
        raise BackupRejected(f"{error.filename} cannot be written: {error.strerror}.") from error


class BackupNotMade(VitacError):
    """A backup cannot be written where it was asked for; nothing was left behind."""


def back_up(
    services: Services, destination: Path, *, report_file: Callable[[int, int], None] = lambda *_: None
) -> BackupDescription:
    """Write the database and all uploaded files, as they are at one moment, to a new file that only its owner may read.

    Track files of the organizers' own are in it, too. Submissions and results that arrive meanwhile are not, nor are
    uploads in pieces.

    Args:
        services: the open service.
        destination: file to write; must not exist.
        report_file: called after each uploaded file with the number written and the total.

    Raises:
        BackupNotMade: the file exists or cannot be written.
        DatabaseToolFailed: the database could not be dumped.
        DocumentRejected: a file among the own track files is none.
        ServiceError: an uploaded file cannot be read.
    """
    track_files = own_track_files()  # before the dump, which may take long
    try:
        with new_file(destination) as unfinished:
            description = _write(services, track_files, unfinished, report_file)
    except FileExistsError as error:
        raise BackupNotMade(f"{destination} exists; name a file that does not.") from error
    except OSError as error:
        raise BackupNotMade(f"{destination} cannot be written: {error.strerror}.") from error
    with services.database.transaction() as session:
        record(session, CONSOLE, "service.backup", f"file:{destination.name}", {"uploads": len(description.blobs)})
    return description


def _write(
    services: Services, track_files: dict[str, str], unfinished: Path, report_file: Callable[[int, int], None]
) -> BackupDescription:
    folder = unfinished.parent
    dump = folder / DUMP_NAME
    description = _dump(services, track_files, dump)
    with tarfile.open(unfinished, "x:") as tar:
        unfinished.chmod(0o600)
        writer = BackupWriter(tar)
        writer.describe(description)
        writer.add(DUMP_NAME, dump)
        dump.unlink()
        for count, sha256 in enumerate(description.blobs, start=1):
            blob = folder / "blob"
            services.blobs.fetch(sha256, blob)
            writer.add(f"{BLOB_FOLDER}/{sha256}", blob)
            blob.unlink()
            report_file(count, len(description.blobs))
    return description


def _dump(services: Services, track_files: dict[str, str], dump: Path) -> BackupDescription:
    """Dump the database and list the uploaded files that the same snapshot of it refers to."""
    with services.database.engine.connect().execution_options(isolation_level="REPEATABLE READ") as connection:
        # The transaction only waits while the database is dumped, which may take long.
        connection.exec_driver_sql("SET LOCAL idle_in_transaction_session_timeout = 0")
        snapshot = connection.scalar(text("SELECT pg_export_snapshot()"))
        blobs = stored_digests(connection)
        binaries.dump_database(
            services.database.address,
            dump,
            snapshot=snapshot,
            bin_dir=services.settings.postgres_bin_dir,
            without_rows_of=(PartialUpload.__tablename__, UploadPart.__tablename__),
        )
        return BackupDescription(
            made_at=datetime.now(UTC),
            release=version("vitac-arena"),
            schema_revision=_revision(connection),
            dump_sha256=_sha256(dump),
            blobs=tuple(blobs),
            track_files=track_files,
        )


def _revision(connection: Connection) -> str:
    revision = installed_revision(connection)
    assert revision is not None  # noqa: S101 - the service was opened, so its schema is there
    return revision


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class ServiceNotEmpty(VitacError):
    """A backup is restored only into a service without data and without running workers; nothing was changed."""


def check(services: Services, source: Path) -> BackupDescription:
    """Check whether a backup is whole and could be restored into this service; change nothing.

    Raises:
        BackupRejected: the file is not a whole backup, or of a newer version.
        ServiceNotEmpty: the service has data, or workers that use its database.
    """
    with BackupReader.opened(source) as reader:
        _check(services, reader)
        return reader.description


def restore(
    services: Services, source: Path, *, report_file: Callable[[int, int], None] = lambda *_: None
) -> BackupDescription:
    """Check a backup whole, then write its track files, uploads and database, and bring the schema up to date.

    Cut off in the middle it leaves a service without data, into which it can be restored again.

    Args:
        services: the open, empty service.
        source: the backup.
        report_file: called after each uploaded file with the number written and the total.

    Raises:
        BackupRejected: the file is not a whole backup, or of a newer version.
        ServiceNotEmpty: the service has data, or workers that use its database.
        DatabaseToolFailed: the database could not be written.
        ServiceError: the file store cannot be written.
    """
    with BackupReader.opened(source) as reader:
        put_back(_check(services, reader))
        blobs = reader.description.blobs
        with scratch_folder(services.settings.scratch_dir, "restore") as folder:
            for count, sha256 in enumerate(blobs, start=1):
                blob = folder / sha256
                reader.extract_blob(sha256, blob)
                services.blobs.put(blob, sha256)
                blob.unlink()
                report_file(count, len(blobs))
            dump = folder / "database.dump"
            reader.extract_dump(dump)
            _restore_database(services, dump)
        with services.database.transaction() as session:
            made_at = reader.description.made_at.isoformat()
            record(session, CONSOLE, "service.restore", f"file:{source.name}", {"made_at": made_at})
        return reader.description


def _check(services: Services, reader: BackupReader) -> Mapping[Path, str]:
    """Return the track files of the backup that this service lacks."""
    revision = reader.description.schema_revision
    if not knows_revision(revision):
        raise BackupRejected(
            f"The backup is of schema {revision!r}, written by release {reader.description.release}, "
            "which this version does not know; restore it with that release or a newer one."
        )
    with services.database.transaction() as session:
        _require_empty(session, services.settings)
    reader.check()
    return missing_track_files(reader.description.track_files)


def _require_empty(session: Session, settings: Settings) -> None:
    counts = {
        model.__tablename__: session.scalar(select(func.count()).select_from(model)) or 0
        for model in (Team, ApiToken, Submission)
    }
    rows = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    if rows:
        raise ServiceNotEmpty(f"Expected a service without data, got {rows}; restore into a new one.")
    workers = workers_alive(session, settings).alive
    if workers:
        raise ServiceNotEmpty(f"Expected no running workers, got {workers}; stop them and try again.")


def _restore_database(services: Services, dump: Path) -> None:
    """Replace the empty schema by the dump's; a process that starts meanwhile waits before it would migrate."""
    owner = create_engine(sqlalchemy_url(services.database.owner_address), poolclass=NullPool)
    with owner.connect() as connection:  # closed after use: the advisory lock lasts as long as the connection
        wait_for_lock(connection, AdvisoryLock.SCHEMA_UPGRADE)
        connection.commit()
        with Session(connection) as session, session.begin():
            _drop_empty_schema(session, services.settings)
        services.database.dispose()
        binaries.restore_database(services.database.owner_address, dump, bin_dir=services.settings.postgres_bin_dir)
    upgrade(services.database)


def _drop_empty_schema(session: Session, settings: Settings) -> None:
    """Check again under locks: a team or a worker may have registered while the uploaded files were written."""
    tables = ", ".join(model.__tablename__ for model in (Team, ApiToken, Submission, Worker))
    session.execute(text(f"LOCK TABLE {tables} IN ACCESS EXCLUSIVE MODE"))
    _require_empty(session, settings)
    session.execute(text("DROP SCHEMA public CASCADE"))
    session.execute(text("CREATE SCHEMA public"))
