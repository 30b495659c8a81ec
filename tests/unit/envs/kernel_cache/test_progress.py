"""How far compiling is can be read while it lasts, of own processes only."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from vitac.envs.kernel_cache.progress import LOCK_FILE, CompileProgress
from vitac.envs.kernel_cache.turns import CompilingTurn

COMPILE = """
import sys
from pathlib import Path
from vitac.envs.kernel_cache.progress import CompileProgress
from vitac.envs.kernel_cache.turns import CompilingTurn
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
