"""One process compiles at a time; another waits, says so, and goes on when the first is done or dead."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest
from vitac.envs import kernel_cache
from vitac.envs.kernel_cache import LOCK_FILE, CompileProgress, CompilingTurn

START = CompileProgress(compiled=0, kernels=9)
HOLD = """
import sys
from pathlib import Path
from vitac.envs.kernel_cache import CompileProgress
from vitac.envs.kernel_cache import CompilingTurn
with CompilingTurn().taken(Path(sys.argv[1]), CompileProgress(compiled=0, kernels=9)):
    print("taken", flush=True)
    sys.stdin.read()
"""


def open_files() -> set[str]:
    """The numbers of this process's open files; reading them takes one. What other tests left open may be closed."""
    return {path.name for path in Path("/proc/self/fd").iterdir()}


def holder(folder: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", HOLD, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "taken\n"
    return process


def test_a_process_waits_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(kernel_cache, "_SILENT_S", 0.0)
    with holder(tmp_path) as first:
        looks = []

        def end_the_other(_: float) -> None:
            looks.append(first.poll())
            first.kill()
            first.wait()

        monkeypatch.setattr("time.sleep", end_the_other)
        with CompilingTurn().taken(tmp_path, START):
            pass
    with holder(tmp_path) as first, CompilingTurn().taken(tmp_path, START):
        pass
    assert looks == [None, None]
    said = f"Another process is compiling the physics into {tmp_path}; waiting for it, at most 15 minutes."
    assert caplog.messages == [said]


def test_one_that_never_ends_is_waited_for_no_longer_than_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(kernel_cache, "_LONGEST_S", 0.0)
    with holder(tmp_path) as first:
        with CompilingTurn().taken(tmp_path, START):
            pass
        assert first.poll() is None
    assert "another process has held it for 0 minutes; end that" in caplog.text
    assert "compiling without it" in caplog.text


def test_a_turn_is_taken_again_within_itself_and_given_back_after_an_error(tmp_path: Path) -> None:
    turn = CompilingTurn()
    with pytest.raises(ZeroDivisionError), turn.taken(tmp_path, START), turn.taken(tmp_path, START):
        raise ZeroDivisionError
    with holder(tmp_path) as other:
        other.communicate()
    assert other.returncode == 0


@pytest.fixture
def without_rights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of another user, also where the tests run as root."""
    make = os.open

    def refuse(path: Path, flags: int, mode: int = 0o777) -> int:
        if flags & os.O_CREAT:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return make(path, flags, mode)

    monkeypatch.setattr("os.open", refuse)
    return tmp_path


def test_without_a_lock_file_a_process_says_so_once_and_goes_on(
    without_rights: Path, caplog: pytest.LogCaptureFixture
) -> None:
    turn, done = CompilingTurn(), []
    for number in range(3):
        with turn.taken(without_rights, START):
            turn.tell(START)
            done.append(number)
    assert done == [0, 1, 2]
    lock = without_rights / LOCK_FILE
    assert caplog.messages == [
        f"Expected a folder that takes a lock file, got {without_rights} ([Errno 13] Permission denied: '{lock}'); "
        "compiling without it, which other processes may do at the same time."
    ]
    assert not lock.exists()


def test_a_folder_that_was_removed_and_a_file_in_its_place_stop_nobody(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").touch()
    for folder in (tmp_path / "gone", tmp_path / "file"):
        with CompilingTurn().taken(folder, START):
            pass
    assert [("No such file" in message, "Not a directory" in message) for message in caplog.messages] == [
        (True, False),
        (False, True),
    ]


def test_a_file_system_without_locks_stops_nobody_and_leaves_no_open_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def no_locks(_: int, __: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", no_locks)
    before = open_files()
    with CompilingTurn().taken(tmp_path, START):
        assert open_files() <= before
    assert "No locks available" in caplog.text
    assert (tmp_path / LOCK_FILE).read_bytes() == b""


def test_an_error_of_the_body_is_not_taken_for_one_of_the_lock(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for folder in (tmp_path, tmp_path / "gone"):
        with pytest.raises(OSError, match="of the body"), CompilingTurn().taken(folder, START):
            raise OSError("of the body")
    assert not [message for message in caplog.messages if "of the body" in message]


def test_once_there_can_be_a_lock_it_is_taken(tmp_path: Path) -> None:
    turn, folder = CompilingTurn(), tmp_path / "later"
    with turn.taken(folder, START):
        assert CompileProgress.read_own_processes(folder) is None
    folder.mkdir()
    with turn.taken(folder, START):
        assert CompileProgress.read_own_processes(folder) == START


def test_a_process_that_waits_in_vain_is_interrupted_without_an_open_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    with holder(tmp_path) as other:
        before = open_files()
        monkeypatch.setattr("time.sleep", interrupt)
        with pytest.raises(KeyboardInterrupt), CompilingTurn().taken(tmp_path, START):
            pytest.fail("the turn was another process's")
        assert open_files() <= before
        other.communicate()
