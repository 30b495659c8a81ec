"""Makes a backup of a service while it serves; called by `vitac admin backup`."""

import hashlib
import os
import tarfile
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from pydantic import TypeAdapter
from sqlalchemy import Connection, text
from vitac.errors import VitacError
from vitac.evaluator.strict_model import DocumentRejected, Word
from vitac.evaluator.tracks.registry import TRACKS_FOLDER_VARIABLE

from ..audit import record
from ..database import binaries
from ..database.models import PartialUpload, UploadPart
from ..database.schema import installed_revision
from ..principals import CONSOLE
from ..services import Services
from ..storage.scratch import new_file
from ..submissions.files import stored_digests
from .archive import BLOB_FOLDER, DUMP_NAME, BackupDescription, BackupRejected, BackupWriter

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
