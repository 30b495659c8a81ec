import errno
import fcntl
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
from vitac.server.storage.scratch import remove_leftovers, remove_unused, scratch_folder, shared_folder

HOLDER = """
import sys, time
from pathlib import Path
from vitac.server.storage.scratch import scratch_folder
with scratch_folder(Path(sys.argv[1]), "worker") as folder:
    (folder / "unpacked").mkdir()
    print(folder, flush=True)
    time.sleep(600)
"""


def test_a_folder_is_gone_with_its_block(tmp_path: Path) -> None:
    with scratch_folder(tmp_path / "scratch", "upload") as folder:
        (folder / "half").write_bytes(b"half")
        assert folder.name.startswith("upload-")
        assert folder.stat().st_mode & 0o777 == 0o700
    assert list((tmp_path / "scratch").iterdir()) == []


def test_only_the_folder_of_a_process_that_is_gone_is_removed(tmp_path: Path) -> None:
    with (
        subprocess.Popen([sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True) as other,
        scratch_folder(tmp_path, "worker") as mine,
    ):
        assert other.stdout is not None
        theirs = Path(other.stdout.readline().rstrip())
        remove_leftovers(tmp_path)
        assert sorted(tmp_path.iterdir()) == sorted([mine, theirs])
        other.send_signal(signal.SIGKILL)
        other.wait()
        remove_leftovers(tmp_path)
        assert list(tmp_path.iterdir()) == [mine]


def test_what_others_have_in_the_folder_is_left_alone(tmp_path: Path) -> None:
    host = socket.gethostname()
    names = ["worker-elsewhere-x", f"worker-{host}-9-x", f"{host}-x", "notes"]
    for name in names:
        (tmp_path / name).mkdir()
    file = tmp_path / f"upload-{host}-x"
    file.touch()
    remove_leftovers(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names, file.name])
    remove_leftovers(tmp_path / "absent")


def test_where_folders_cannot_be_locked_they_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(descriptor: int, operation: int) -> None:
        raise OSError(errno.EBADF, "flock")

    monkeypatch.setattr(fcntl, "flock", refused)
    with scratch_folder(tmp_path, "upload") as folder:
        remove_leftovers(tmp_path)
        assert folder.is_dir()
    assert not folder.exists()


def fill_slowly(folder: Path) -> None:
    time.sleep(0.05)
    (folder / "image").write_text("unpacked")


def test_a_shared_folder_is_filled_once_and_goes_with_the_last_who_uses_it(tmp_path: Path) -> None:
    fills: list[Path] = []
    leave = threading.Barrier(4)

    def fill(folder: Path) -> None:
        fills.append(folder)
        fill_slowly(folder)

    def use() -> None:
        with shared_folder(tmp_path / "images", "a", fill) as folder:
            assert (folder / "image").read_text() == "unpacked"
            leave.wait(10)
            assert (folder / "image").exists()

    threads = [threading.Thread(target=use) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(fills) == 1
    remove_unused(tmp_path / "images")  # of two that leave at the same moment each may see the other
    assert list((tmp_path / "images").iterdir()) == []


def test_who_found_a_folder_empty_does_not_wait_for_those_who_use_it_once_it_is_filled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flock, users = fcntl.flock, ExitStack()
    late = threading.Thread(target=lambda: ExitStack().enter_context(shared_folder(tmp_path, "a", fill_slowly)))

    def lock(descriptor: int, operation: int) -> None:
        if operation & fcntl.LOCK_EX and threading.current_thread() is late:
            monkeypatch.setattr(fcntl, "flock", flock)
            flock(descriptor, fcntl.LOCK_UN)
            users.enter_context(shared_folder(tmp_path, "a", fill_slowly))
        flock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", lock)
    with users:
        late.start()
        late.join(5)
        assert not late.is_alive()


def test_a_shared_folder_that_cannot_be_filled_is_not_there_for_the_next(tmp_path: Path) -> None:
    def fail(folder: Path) -> None:
        (folder / "half").touch()
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="the disk is full"), shared_folder(tmp_path, "a", fail):
        pass
    assert list(tmp_path.iterdir()) == []
    with shared_folder(tmp_path, "a", fill_slowly) as folder:
        assert [path.name for path in folder.iterdir()] == ["image"]


def test_what_a_killed_process_has_filled_is_used_and_what_it_has_begun_is_filled_anew(tmp_path: Path) -> None:
    for name, is_complete in (("whole", True), ("half", False)):
        (tmp_path / name / "content").mkdir(parents=True)
        (tmp_path / name / "content" / "left").touch()
        if is_complete:
            (tmp_path / name / "complete").touch()
    with (
        shared_folder(tmp_path, "whole", fill_slowly) as whole,
        shared_folder(tmp_path, "half", fill_slowly) as half,
    ):
        remove_unused(tmp_path)
        assert [path.name for folder in (whole, half) for path in folder.iterdir()] == ["left", "image"]


def test_a_folder_of_somebody_else_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.raises(PermissionError, match="belongs to somebody else"), shared_folder(tmp_path, "a", fill_slowly):
        pass
