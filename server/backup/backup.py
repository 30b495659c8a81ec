"""Makes a backup of a service while it serves; called by `vitac admin backup`."""

import hashlib
import tarfile
from collections.abc import Callable
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from sqlalchemy import Connection, text
from vitac.envs.errors import VitacError

from ..audit import record
from ..db.models import PartialUpload, UploadPart
from ..db.schema import installed_revision
from ..postgres import tools
from ..principals import CONSOLE
from ..services import Services
from ..storage.new_file import new_file
from ..submissions.files import stored_digests
from .archive import BLOB_FOLDER, DUMP_NAME, BackupDescription, BackupWriter
from .track_files import own_track_files


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
        tools.dump(
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
