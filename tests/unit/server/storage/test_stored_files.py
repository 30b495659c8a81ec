import hashlib
import os
import threading
import time
from datetime import timedelta
from pathlib import Path

import pytest
from database_work import is_waiting_for_a_lock
from service_factories import make_principal, make_upload
from sqlalchemy import update
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission
from vitac.server.errors import ServiceError
from vitac.server.services import Services
from vitac.server.settings import load_settings
from vitac.server.storage import stored_files
from vitac.server.storage.blobs import BlobStore
from vitac.server.submissions import creation
from worker_fakes import eventually

DAY = timedelta(days=1)
CONTENT = b"content"
DIGEST = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture
def services(database: Database, tmp_path: Path) -> Services:
    settings = load_settings(state_dir=tmp_path, database_url="postgresql:///unused")
    return Services(settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=None)


def written(tmp_path: Path) -> Path:
    path = tmp_path / "file"
    path.write_bytes(CONTENT)
    return path


def store(services: Services, path: Path) -> None:
    with services.database.transaction() as session:
        stored_files.store(session, services.blobs, path, DIGEST)


def age(services: Services) -> None:
    """Make the stored file two days old."""
    before = time.time() - 2 * DAY.total_seconds()
    [file] = [path for path in (services.settings.state_dir / "blobs").rglob("*") if path.is_file()]
    os.utime(file, (before, before))


def remove(services: Services) -> None:
    with services.database.transaction() as session:
        stored_files.remove_if_older(session, services.blobs, DIGEST, DAY)


def is_there(services: Services) -> bool:
    return DIGEST in services.blobs.list_older_than(timedelta(seconds=-60))


def test_an_old_file_is_removed_and_a_new_one_stays(services: Services, tmp_path: Path) -> None:
    store(services, written(tmp_path))
    remove(services)
    assert is_there(services)
    age(services)
    remove(services)
    assert not is_there(services)


def test_a_file_that_is_stored_again_is_new(services: Services, tmp_path: Path) -> None:
    store(services, written(tmp_path))
    age(services)
    store(services, written(tmp_path))
    remove(services)
    assert is_there(services)


def test_removing_waits_until_whoever_stores_has_committed(services: Services, tmp_path: Path) -> None:
    store(services, written(tmp_path))
    age(services)
    with services.database.transaction() as session:
        stored_files.store(session, services.blobs, written(tmp_path), DIGEST)
        removing = threading.Thread(target=remove, args=[services])
        removing.start()
        eventually(lambda: is_waiting_for_a_lock(services.database))
    removing.join()
    assert is_there(services)


def test_a_file_is_not_named_once_it_was_removed_and_not_removed_once_it_is_named(
    services: Services, tmp_path: Path
) -> None:
    database, blobs = services.database, services.blobs
    store(services, written(tmp_path))
    with database.transaction() as session:
        stored_files.require_stored(session, blobs, [DIGEST])
        remover = threading.Thread(target=stored_files.remove_unnamed, args=[database, blobs, [DIGEST]])
        remover.start()
        eventually(lambda: is_waiting_for_a_lock(database))
        creation.create(session, make_principal(session), make_upload(archive_sha256=DIGEST))
    remover.join()
    assert is_there(services)
    with database.transaction() as session:
        session.execute(update(Submission).values(archive_sha256="0" * 64))
    stored_files.remove_unnamed(database, blobs, [DIGEST])
    with database.transaction() as session, pytest.raises(ServiceError, match="send it again"):
        stored_files.require_stored(session, blobs, [DIGEST])
