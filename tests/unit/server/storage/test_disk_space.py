import errno
import os
from pathlib import Path

import psycopg
import pytest
from obstore.exceptions import GenericError
from small_disk import fill, make_room, small_disk
from sqlalchemy.exc import OperationalError
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.settings import load_settings
from vitac.server.storage.blobs import BlobStore
from vitac.server.storage.scratch import RESERVED_BYTES, RESERVED_SHARE, has_space, is_disk_full, require_room


def caused_by(cause: Exception) -> Exception:
    error = RuntimeError("a copy failed")
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "is_full"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), True),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), True),
        (OSError(errno.EACCES, "Permission denied"), False),
        (GenericError("Unable to copy data to file: No space left on device (os error 28)"), True),
        (GenericError("Unable to open file: Permission denied (os error 13)"), False),
        (OperationalError("INSERT", {}, psycopg.errors.DiskFull()), True),
        (OperationalError("INSERT", {}, psycopg.errors.AdminShutdown()), False),
        (caused_by(OSError(errno.ENOSPC, "No space left on device")), True),
        (caused_by(ValueError("something else")), False),
    ],
)
def test_full_disk_is_told_from_other_failures(error: Exception, is_full: bool) -> None:
    assert is_disk_full(error) == is_full


def test_uploads_leave_disk_space_to_the_others(tmp_path: Path) -> None:
    disk, settings = os.statvfs(tmp_path), load_settings(state_dir=tmp_path)
    free_bytes, all_bytes = disk.f_bavail * disk.f_frsize, disk.f_blocks * disk.f_frsize
    require_room(settings, 0)
    with pytest.raises(ServiceError) as refusal:
        require_room(settings, free_bytes - min(RESERVED_BYTES, int(RESERVED_SHARE * all_bytes)) // 2)
    assert refusal.value.code is ProblemCode.STORAGE_FULL


def test_uploads_leave_room_where_they_are_stored_too(tmp_path: Path) -> None:
    (tmp_path / "my files").mkdir()
    with small_disk(tmp_path / "my files", 4 << 20) as disk:
        settings = load_settings(state_dir=tmp_path, storage_url=disk.as_uri())
        require_room(settings, 0)
        with pytest.raises(ServiceError, match="disk of the service is full"):
            require_room(settings, 4 << 20)


def test_a_file_that_does_not_fit_is_refused_and_leaves_nothing_until_there_is_room(tmp_path: Path) -> None:
    large = tmp_path / "large"
    large.write_bytes(bytes(3 << 20))
    (tmp_path / "small").mkdir()
    with small_disk(tmp_path / "small", 4 << 20) as disk:
        store = BlobStore.from_settings(load_settings(state_dir=disk))
        assert has_space(disk)
        fill(disk)
        assert not has_space(disk)
        with pytest.raises(ServiceError) as refusal:
            store.put(large, "a" * 64)
        assert (refusal.value.code, refusal.value.status) == (ProblemCode.STORAGE_FULL, 507)
        assert not store.holds("a" * 64)
        assert [path for path in (disk / "blobs").rglob("*") if path.is_file()] == []
        make_room(disk)
        store.put(large, "a" * 64)
        assert store.holds("a" * 64)
