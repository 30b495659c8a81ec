"""Brings a backup into an empty service; called by `vitac admin restore`."""

from collections.abc import Callable, Mapping
from pathlib import Path

from sqlalchemy import NullPool, create_engine, func, select, text
from sqlalchemy.orm import Session
from vitac.errors import VitacError

from ..audit import record
from ..database import binaries
from ..database.engine import sqlalchemy_url
from ..database.locks import AdvisoryLock, wait_for_lock
from ..database.models import ApiToken, Submission, Team, Worker
from ..database.schema import knows_revision, upgrade
from ..principals import CONSOLE
from ..queue.workers import workers_alive
from ..services import Services
from ..settings import Settings
from ..storage.scratch import scratch_folder
from .archive import BackupDescription, BackupReader, BackupRejected
from .backup import missing_track_files, put_back


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
