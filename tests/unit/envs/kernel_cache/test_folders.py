"""What nobody uses any more is removed from the cache; a filled one that cannot be written to is read."""

import os
import time
from pathlib import Path

import pytest
from vitac.envs.kernel_cache.folders import cache_directory, note_use, remove_unused

DAY_S = 86400.0


def folder(path: Path, days_ago: float) -> Path:
    path.mkdir(parents=True)
    (path / "kernel.nbc").touch()
    used = time.time() - days_ago * DAY_S
    os.utime(path, (used, used))
    return path


def test_only_folders_unused_for_a_month_are_removed(tmp_path: Path) -> None:
    directory = tmp_path / "kernels"
    kept = [folder(directory / "a-1", 29), folder(tmp_path / "kernels-0123", 1), folder(tmp_path / "other", 99)]
    removed = [folder(directory / "a-0", 31), folder(tmp_path / "kernels-4567", 31)]
    (directory / "compiling.lock").touch()
    remove_unused(directory)
    assert [path.exists() for path in kept] == [True] * 3
    assert [path.exists() for path in removed] == [False] * 2
    assert (directory / "compiling.lock").exists()


def test_a_folder_that_is_used_stays(tmp_path: Path) -> None:
    used = folder(tmp_path / "kernels" / "a-0", 31)
    note_use(used)
    remove_unused(tmp_path / "kernels")
    assert used.exists()


def test_a_folder_that_another_process_removed_is_no_error(tmp_path: Path) -> None:
    note_use(tmp_path / "removed")


def test_a_folder_of_another_user_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    used = folder(tmp_path / "a-0", 31)
    monkeypatch.setattr(os, "utime", refuse)
    note_use(used)


@pytest.fixture
def unwritable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of kernels, which this process may only read."""
    directory = tmp_path / "kernels"
    directory.mkdir()
    monkeypatch.setenv("VITAC_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != directory)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return directory


def test_a_filled_folder_that_cannot_be_written_to_is_read(unwritable: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder(unwritable / "a-0", 0)
    (unwritable / "a-0" / "kernel.nbi").touch()
    assert cache_directory.__wrapped__() == unwritable
    assert caplog.messages == []


def test_an_empty_folder_that_cannot_be_written_to_is_named_with_the_remedy(
    unwritable: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert cache_directory.__wrapped__().parent.name.startswith("vitac-")
    (message,) = caplog.messages
    assert message.startswith(f"Compiled kernels cannot be stored in {unwritable.parent}: every process compiles")
    assert "vitac compile" in message
