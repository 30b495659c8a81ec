"""One process compiles at a time; another waits, says so, and goes on when the first is done or dead."""

import subprocess
import sys
from pathlib import Path

import pytest
from vitac.envs.kernel_cache import turns
from vitac.envs.kernel_cache.progress import CompileProgress
from vitac.envs.kernel_cache.turns import CompilingTurn

START = CompileProgress(compiled=0, kernels=9)
HOLD = """
import sys
from pathlib import Path
from vitac.envs.kernel_cache.progress import CompileProgress
from vitac.envs.kernel_cache.turns import CompilingTurn
with CompilingTurn().taken(Path(sys.argv[1]), CompileProgress(compiled=0, kernels=9)):
    print("taken", flush=True)
    sys.stdin.read()
"""


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
    monkeypatch.setattr(turns, "_SILENT_S", 0.0)
    with holder(tmp_path) as first:
        looks = []

        def end_the_other(_: float) -> None:
            looks.append(first.poll())
            first.kill()
            first.wait()

        monkeypatch.setattr("time.sleep", end_the_other)
        with CompilingTurn().taken(tmp_path, START):
            pass
    assert looks == [None]
    assert caplog.messages == [f"Another process is compiling the physics into {tmp_path}; waiting for it."]


def test_a_turn_is_taken_again_within_itself_and_given_back_after_an_error(tmp_path: Path) -> None:
    turn = CompilingTurn()
    with pytest.raises(ZeroDivisionError), turn.taken(tmp_path, START), turn.taken(tmp_path, START):
        raise ZeroDivisionError
    with holder(tmp_path) as other:
        other.communicate()
    assert other.returncode == 0
