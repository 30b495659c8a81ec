"""The storage in a bucket of a real S3-speaking server process (moto's), also when one side is killed in the middle."""

import hashlib
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest
from databases import opened_database
from s3_server import S3Server, s3_server
from service_client import make_archive, problem_of, running_service
from service_factories import make_settings
from vitac.server.database.engine import Database
from vitac.server.errors import ServiceError
from vitac.server.storage.blobs import PART_BYTES, BlobStore, StoredFileLost, make_key
from worker_fakes import eventually

LARGE_BYTES = 160 << 20
PUT = """
import sys
from pathlib import Path
from vitac.server.settings import load_settings
from vitac.server.storage.blobs import BlobStore

BlobStore.from_settings(load_settings()).put(Path(sys.argv[1]), sys.argv[2])
"""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    with s3_server(tmp_path_factory.mktemp("s3")) as server:
        yield server


@pytest.fixture
def s3(server: S3Server, monkeypatch: pytest.MonkeyPatch) -> S3Server:
    """The server with an empty bucket, and the environment by which we find it."""
    server.empty()
    for name, value in server.environment.items():
        monkeypatch.setenv(name, value)
    return server


@pytest.fixture
def database() -> Iterator[Database]:
    with opened_database() as database:
        yield database


@pytest.fixture
def blobs(s3: S3Server) -> BlobStore:
    return BlobStore.from_settings(make_settings())


def a_file(folder: Path, n_bytes: int) -> tuple[Path, str]:
    """A file, most of it zeros, and its digest."""
    path = folder / "source"
    with path.open("wb") as file:
        file.truncate(n_bytes)
        file.write(b"begin")
    with path.open("rb") as file:
        return path, hashlib.file_digest(file, "sha256").hexdigest()


@pytest.mark.parametrize("n_bytes", [5, 2 * PART_BYTES + 1], ids=["small", "several parts"])
def test_files_go_into_the_bucket_and_come_back_whole(
    s3: S3Server, blobs: BlobStore, tmp_path: Path, n_bytes: int
) -> None:
    blobs.check()
    path, digest = a_file(tmp_path, n_bytes)
    for _again in range(2):
        blobs.put(path, digest)
    assert s3.stored_keys() == [f"files/{make_key(digest)}"]
    assert blobs.list_older_than(timedelta(seconds=-60)) == [digest]
    blobs.fetch(digest, tmp_path / "copy")
    assert (tmp_path / "copy").stat().st_size == n_bytes
    blobs.delete(digest)
    assert (s3.stored_keys(), s3.unfinished_uploads()) == ([], [])
    with pytest.raises(StoredFileLost, match="is gone"):
        blobs.fetch(digest, tmp_path / "other copy")


@pytest.mark.slow
def test_kill_in_the_middle_of_storing_leaves_no_file_and_the_next_attempt_succeeds(
    s3: S3Server, blobs: BlobStore, tmp_path: Path
) -> None:
    path, digest = a_file(tmp_path, LARGE_BYTES)
    with subprocess.Popen([sys.executable, "-c", PUT, str(path), digest]) as process:
        eventually(lambda: bool(s3.unfinished_uploads()))
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL, "too late: the file was stored before the kill"
    assert s3.stored_keys() == []
    assert not blobs.holds(digest)
    blobs.put(path, digest)
    blobs.fetch(digest, tmp_path / "copy")
    assert (tmp_path / "copy").stat().st_size == LARGE_BYTES


@pytest.mark.slow
def test_kill_of_the_bucket_in_the_middle_of_storing_is_a_named_refusal(
    s3: S3Server, blobs: BlobStore, tmp_path: Path
) -> None:
    path, digest = a_file(tmp_path, LARGE_BYTES)

    def kill_in_the_middle() -> None:
        eventually(lambda: bool(s3.unfinished_uploads()))
        s3.kill()

    killer = threading.Thread(target=kill_in_the_middle)
    killer.start()
    with pytest.raises(ServiceError, match="The file store does not work"):
        blobs.put(path, digest)
    killer.join()
    with pytest.raises(ServiceError, match="The file store does not work"):
        blobs.check()


@pytest.mark.slow
def test_upload_to_a_bucket_that_is_away_is_refused_and_possible_again_later(
    s3: S3Server, database: Database, tmp_path: Path
) -> None:
    with running_service(database, tmp_path / "state", storage_url=s3.environment["VITAC_STORAGE_URL"]) as service:
        s3.kill()
        assert service.client.get("/ready").status_code == 503
        problem_of(service.upload(make_archive()), 503, "storage_unavailable")
        assert service.get("/submissions").json()["items"] == []
        s3.start()
        assert service.client.get("/ready").json()["storage"] == "ok"
        assert service.upload(make_archive()).status_code == 202
        assert len(s3.stored_keys()) == 1
