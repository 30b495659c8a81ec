import hashlib
from datetime import timedelta
from pathlib import Path

import pytest
from obstore.store import MemoryStore
from service_factories import make_settings
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.storage.blobs import PART_BYTES, BlobStore

CONTENT = b"content " * 1000


@pytest.fixture(params=["local", "url", "memory"])
def blobs(request: pytest.FixtureRequest, tmp_path: Path) -> BlobStore:
    if request.param == "memory":
        return BlobStore(MemoryStore())
    (tmp_path / "bucket").mkdir()
    url = f"file://{tmp_path}/bucket" if request.param == "url" else None
    return BlobStore.from_settings(make_settings(state_dir=tmp_path, storage_url=url))


def put(blobs: BlobStore, folder: Path, content: bytes = CONTENT) -> str:
    path = folder / "source"
    path.write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()
    blobs.put(path, digest)
    return digest


def test_file_comes_back_as_it_was_and_storing_it_again_is_harmless(blobs: BlobStore, tmp_path: Path) -> None:
    digest = put(blobs, tmp_path)
    assert put(blobs, tmp_path) == digest
    blobs.fetch(digest, tmp_path / "copy")
    assert (tmp_path / "copy").read_bytes() == CONTENT


def test_file_of_several_parts_comes_back_whole(blobs: BlobStore, tmp_path: Path) -> None:
    content = bytes(range(256)) * (PART_BYTES // 256) * 2 + b"rest"
    blobs.fetch(put(blobs, tmp_path, content), tmp_path / "copy")
    assert (tmp_path / "copy").read_bytes() == content


def test_missing_file_is_a_named_refusal(blobs: BlobStore, tmp_path: Path) -> None:
    assert not blobs.holds("0" * 64)
    with pytest.raises(ServiceError, match="is gone") as refused:
        blobs.fetch("0" * 64, tmp_path / "copy")
    assert refused.value.code is ProblemCode.STORAGE_UNAVAILABLE


def test_altered_file_is_refused(tmp_path: Path) -> None:
    blobs = BlobStore.from_settings(make_settings(state_dir=tmp_path))
    digest = put(blobs, tmp_path)
    next((tmp_path / "blobs").rglob(digest)).write_bytes(b"other")
    with pytest.raises(ServiceError, match="was altered"):
        blobs.fetch(digest, tmp_path / "copy")


def test_files_are_listed_by_age_and_deleted(blobs: BlobStore, tmp_path: Path) -> None:
    digest = put(blobs, tmp_path)
    assert blobs.list_older_than(timedelta(hours=1)) == []
    assert blobs.list_older_than(timedelta(seconds=-5)) == [digest]
    blobs.delete(digest)
    blobs.delete(digest)
    assert blobs.list_older_than(timedelta(seconds=-5)) == []


def test_check_passes_on_a_store_that_works_and_names_one_that_does_not(blobs: BlobStore, tmp_path: Path) -> None:
    blobs.check()
    broken = BlobStore.from_settings(make_settings(state_dir=tmp_path / "other"))
    folder = tmp_path / "other" / "blobs"
    folder.rmdir()
    folder.write_text("not a folder")
    with pytest.raises(ServiceError, match="The file store does not work"):
        broken.check()
