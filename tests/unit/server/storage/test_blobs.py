import errno
import hashlib
import os
import threading
import time
from collections.abc import Callable
from datetime import timedelta
from itertools import accumulate
from pathlib import Path

import obstore
import pytest
from obstore.exceptions import GenericError
from obstore.store import LocalStore, MemoryStore
from service_factories import make_settings
from vitac.server.errors import ProblemCode, ServiceError, ServiceSettingsError
from vitac.server.storage import blobs as blobs_module
from vitac.server.storage.blobs import PART_BYTES, BlobStore, StoredFileLost, cut, make_key

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


def put_in_pieces(blobs: BlobStore, folder: Path, *parts: bytes) -> str:
    """Store parts as one file, each of which is a piece."""
    path = folder / "source"
    path.write_bytes(b"".join(parts))
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    ends = [*accumulate(map(len, parts))]
    blobs.put_in_pieces(path, digest, cut(path, zip([0, *ends], map(len, parts), strict=False)))
    return digest


def test_files_share_their_large_pieces_and_each_comes_back_whole(blobs: BlobStore, tmp_path: Path) -> None:
    base, first, second = bytes(300_000), b"one" * 50_000, b"two" * 50_000
    one = put_in_pieces(blobs, tmp_path, b"head", base, b"between", first)
    two = put_in_pieces(blobs, tmp_path, b"other", base, second)
    assert blobs.read(one) == b"head" + base + b"between" + first
    assert blobs.read(two) == b"other" + base + second
    assert set(blobs.list_pieces(one)) & set(blobs.list_pieces(two)) == {hashlib.sha256(base).hexdigest()}
    assert sorted(blobs.list_older_than(timedelta(seconds=-5))) == sorted([one, two])
    blobs.delete(one)
    assert not blobs.holds(one)
    assert blobs.read(two) == b"other" + base + second
    assert set(blobs.list_older_than(timedelta(seconds=-5))) == {two, hashlib.sha256(first).hexdigest()}


@pytest.mark.parametrize("url", ["file:///no/such/folder", "s4://bucket", "folder"])
def test_address_that_names_no_store_is_a_sentence(url: str, tmp_path: Path) -> None:
    with pytest.raises(ServiceSettingsError) as refused:
        BlobStore.from_settings(make_settings(state_dir=tmp_path, storage_url=url))
    assert str(refused.value).startswith(f"VITAC_STORAGE_URL is '{url}': expected s3://bucket/prefix or file:///folder")
    assert len(str(refused.value).splitlines()) == 1


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


class EagerOther:
    """Removes a file just before it is removed: as another process would that cleans up at the same time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.delete = obstore.delete
        monkeypatch.setattr(obstore, "delete", self)

    def __call__(self, store: LocalStore, keys: str | list[str]) -> None:
        first = keys if isinstance(keys, str) else keys[0]
        self.delete(store, first)
        self.delete(store, keys)


@pytest.mark.parametrize("action", ["delete", "delete_part", "delete_parts", "check"])
def test_what_somebody_else_removes_at_the_same_time_is_gone_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, action: str
) -> None:
    blobs = BlobStore.from_settings(make_settings(state_dir=tmp_path))
    digest = put(blobs, tmp_path)
    parts = [blobs.put_part("upload-a", name, b"x") for name in ("1", "2", "3")]
    actions: dict[str, Callable[[], None]] = {
        "delete": lambda: blobs.delete(digest),
        "delete_part": lambda: blobs.delete_part(parts[0]),
        "delete_parts": lambda: blobs.delete_parts("upload-a"),
        "check": blobs.check,
    }
    with monkeypatch.context() as patch:
        EagerOther(patch)
        actions[action]()
    assert blobs.holds(digest) is (action != "delete")
    left = {"delete_part": 2, "delete_parts": 0}.get(action, 3)
    assert len(list(tmp_path.glob("**/partial/upload-a/*"))) == left


def test_a_file_that_is_stored_again_after_long_counts_as_new(tmp_path: Path) -> None:
    blobs = BlobStore.from_settings(make_settings(state_dir=tmp_path))
    digest = put(blobs, tmp_path)
    stored = next(path for path in tmp_path.glob("**/sha256/**/*") if path.name == digest)
    long_ago = time.time() - 2 * blobs_module.RECENTLY.total_seconds()
    os.utime(stored, (long_ago, long_ago))
    assert blobs.is_older_than(digest, blobs_module.RECENTLY)
    put(blobs, tmp_path)
    assert not blobs.is_older_than(digest, blobs_module.RECENTLY)
    assert not blobs.is_older_than("0" * 64, timedelta(0))


def test_a_check_that_hangs_is_waited_for_only_so_long_and_not_begun_twice(
    blobs: BlobStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers, begun = threading.Event(), []

    def hang() -> None:
        begun.append(1)
        answers.wait(120.0)

    monkeypatch.setattr(blobs, "check", hang)
    for _ in range(3):
        with pytest.raises(TimeoutError):
            blobs.check_within(0.01)
    assert begun == [1]
    answers.set()
    blobs.check_within(30.0)
    monkeypatch.undo()
    blobs.check_within(30.0)


def test_parts_are_read_back_and_uploads_are_named_by_age(blobs: BlobStore) -> None:
    key = blobs.put_part("upload-a", "1", b"one")
    blobs.put_part("upload-a", "2", b"two")
    blobs.put_part("upload-b", "1", b"three")
    assert bytes(blobs.part(key)) == b"one"
    assert blobs.uploads_with_parts(timedelta(hours=1)) == set()
    assert blobs.uploads_with_parts(timedelta(seconds=-5)) == {"upload-a", "upload-b"}
    assert blobs.list_older_than(timedelta(seconds=-5)) == []
    blobs.delete_parts("upload-a")
    assert blobs.uploads_with_parts(timedelta(seconds=-5)) == {"upload-b"}
    blobs.delete_parts("upload-a")
    with pytest.raises(ServiceError, match="The file store does not work"):
        blobs.part(key)


class NoStore:
    """Stands for a store whose every request fails."""

    def __init__(self, error: Exception) -> None:
        self._error = error

    def fail(self, *_: object, **__: object) -> None:
        raise self._error


REQUESTS: dict[str, Callable[[BlobStore, Path], object]] = {
    "put": lambda blobs, folder: put(blobs, folder),
    "read": lambda blobs, _: blobs.read("0" * 64),
    "fetch": lambda blobs, folder: blobs.fetch("0" * 64, folder / "copy"),
    "delete": lambda blobs, _: blobs.delete("0" * 64),
    "list_older_than": lambda blobs, _: blobs.list_older_than(timedelta()),
    "put_part": lambda blobs, _: blobs.put_part("upload", "1", b"part"),
    "part": lambda blobs, _: blobs.part("partial/upload/1"),
    "delete_part": lambda blobs, _: blobs.delete_part("partial/upload/1"),
    "delete_parts": lambda blobs, _: blobs.delete_parts("upload"),
    "uploads_with_parts": lambda blobs, _: blobs.uploads_with_parts(timedelta()),
    "check": lambda blobs, _: blobs.check(),
}


@pytest.mark.parametrize("request_", REQUESTS)
@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (GenericError("no\n  route  to host"), ProblemCode.STORAGE_UNAVAILABLE, "work: no route to host. Try again"),
        (OSError(errno.EIO, "I/O error"), ProblemCode.STORAGE_UNAVAILABLE, "does not work: .* I/O error. Try again"),
        (OSError(errno.ENOSPC, "No space left"), ProblemCode.STORAGE_FULL, "full"),
        (GenericError("write failed (os error 28)"), ProblemCode.STORAGE_FULL, "full"),
    ],
)
def test_every_request_of_a_store_that_fails_is_a_named_refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request_: str, error: Exception, code: ProblemCode, message: str
) -> None:
    fail = NoStore(error).fail
    for name in ("put", "get", "head", "list", "delete"):
        monkeypatch.setattr(f"vitac.server.storage.blobs.obstore.{name}", fail)
    with pytest.raises(ServiceError, match=message) as refused:
        REQUESTS[request_](BlobStore(MemoryStore()), tmp_path)
    assert refused.value.code is code
    assert refused.value.__cause__ is error


def test_a_destination_that_is_taken_is_no_lost_file(blobs: BlobStore, tmp_path: Path) -> None:
    digest = put(blobs, tmp_path)
    for destination in (tmp_path / "source", tmp_path / "no-folder" / "copy"):
        with pytest.raises(ServiceError, match="The file store does not work") as refused:
            blobs.fetch(digest, destination)
        assert not isinstance(refused.value, StoredFileLost)


def test_a_long_reason_of_the_store_is_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.server.storage.blobs.obstore.put", NoStore(GenericError("x" * 5000)).fail)
    with pytest.raises(ServiceError) as refused:
        BlobStore(MemoryStore()).check()
    assert str(refused.value).count("x") == 200


@pytest.mark.parametrize("digest", ["ab" + "0" * 62, "ff" + "1" * 62])
def test_keys_are_spread_over_folders(digest: str) -> None:
    assert make_key(digest) == f"sha256/{digest[:2]}/{digest}"


@pytest.mark.parametrize("content", [b"", b"a", CONTENT], ids=["empty", "short", "long"])
def test_a_small_file_is_read_as_it_was(blobs: BlobStore, tmp_path: Path, content: bytes) -> None:
    assert blobs.read(put(blobs, tmp_path, content)) == content


def test_a_file_that_is_gone_or_altered_is_not_read(tmp_path: Path) -> None:
    blobs = BlobStore.from_settings(make_settings(state_dir=tmp_path))
    with pytest.raises(StoredFileLost, match=f"^The stored file {'0' * 64} is gone.$"):
        blobs.read("0" * 64)
    digest = put(blobs, tmp_path)
    next((tmp_path / "blobs").rglob(digest)).write_bytes(CONTENT[:-1])
    with pytest.raises(StoredFileLost, match=f"^The stored file {digest} was altered in the store.$"):
        blobs.read(digest)
