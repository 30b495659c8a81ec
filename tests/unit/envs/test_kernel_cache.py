"""What nobody uses any more is removed from the cache; a filled one that cannot be written to is read."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from vitac.envs.kernel_cache import LOCK_FILE, CompileProgress, CompilingTurn, cache_directory, note_use, remove_unused

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


COMPILE = """
import sys
from pathlib import Path
from vitac.envs.kernel_cache import CompileProgress
from vitac.envs.kernel_cache import CompilingTurn
turn = CompilingTurn()
with turn.taken(Path(sys.argv[1]), CompileProgress(compiled=100, kernels=166)):
    turn.tell(CompileProgress(compiled=7, kernels=8))
    print("told", flush=True)
    sys.stdin.read()
"""
START = CompileProgress(compiled=3, kernels=166)


def test_nothing_is_told_where_nobody_has_compiled(tmp_path: Path) -> None:
    assert CompileProgress.read_own_processes(tmp_path) is None
    assert CompileProgress.read_own_processes(tmp_path / "no folder") is None
    assert list(tmp_path.iterdir()) == []


def test_progress_is_told_from_the_start_of_a_turn_to_its_end(tmp_path: Path) -> None:
    turn = CompilingTurn()
    with turn.taken(tmp_path, START):
        assert CompileProgress.read_own_processes(tmp_path) == START
        further = CompileProgress(compiled=12, kernels=166)
        turn.tell(further)
        assert CompileProgress.read_own_processes(tmp_path) == further
    assert CompileProgress.read_own_processes(tmp_path) is None
    turn.tell(START)
    assert CompileProgress.read_own_processes(tmp_path) is None


def test_the_turn_within_a_turn_keeps_its_progress(tmp_path: Path) -> None:
    turn = CompilingTurn()
    with turn.taken(tmp_path, START):
        with turn.taken(tmp_path, CompileProgress(compiled=0, kernels=1)):
            pass
        assert CompileProgress.read_own_processes(tmp_path) == START


def test_progress_of_a_started_process_is_read_until_it_dies(tmp_path: Path) -> None:
    # The shell stands for the processes between a command and the one that compiles.
    command = ["sh", "-c", '"$@"; true', "sh", sys.executable, "-P", "-c", COMPILE, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"told\n"
        assert CompileProgress.read_own_processes(tmp_path) == CompileProgress(compiled=7, kernels=8)
        os.killpg(process.pid, 9)
        process.wait()
    assert (tmp_path / LOCK_FILE).read_bytes() != b""
    assert CompileProgress.read_own_processes(tmp_path) is None


@pytest.mark.parametrize("process", [1, os.getppid(), 4194304000])
def test_progress_of_other_processes_is_not_ours(tmp_path: Path, process: int) -> None:
    with CompilingTurn().taken(tmp_path, START):
        own = START.as_bytes()
        (tmp_path / LOCK_FILE).write_bytes(own.replace(f"{os.getpid():10}".encode(), f"{process:10}".encode()))
        assert CompileProgress.read_own_processes(tmp_path) is None
        (tmp_path / LOCK_FILE).write_bytes(own)
        assert CompileProgress.read_own_processes(tmp_path) == START


@pytest.mark.parametrize("text", [b"\xff\xfe", b"3 of 166 kernels", b"x" * 1000])
def test_what_is_no_progress_is_passed_over(tmp_path: Path, text: bytes) -> None:
    with CompilingTurn().taken(tmp_path, START):
        (tmp_path / LOCK_FILE).write_bytes(text)
        assert CompileProgress.read_own_processes(tmp_path) is None


def test_reading_leaves_the_turn_free(tmp_path: Path) -> None:
    (tmp_path / LOCK_FILE).write_bytes(START.as_bytes())
    assert CompileProgress.read_own_processes(tmp_path) is None
    with CompilingTurn().taken(tmp_path, START):
        pass
