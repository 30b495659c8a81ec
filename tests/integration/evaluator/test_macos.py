"""On macOS, as far as it can be faked here, one's own policy gets the same result; no Mac was tried."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
FAKE = Path(__file__).parents[2] / "support" / "evaluation" / "fake_macos"
VITAC = "import sys; from vitac.cli.main import main; sys.exit(main())"


def run(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", VITAC, *arguments], env=os.environ | variables, capture_output=True, text=True
    )


def hash_of(finished: subprocess.CompletedProcess[str]) -> str:
    assert finished.returncode == 0, finished.stderr
    return next(line for line in finished.stdout.splitlines() if line.startswith("result hash"))


@pytest.fixture(scope="module")
def heuristic(repository: Path) -> str:
    return str(repository / "examples" / "peg_insertion_heuristic")


def test_a_policy_is_evaluated_without_a_sandbox_and_with_the_same_hash(heuristic: str) -> None:
    there = run("evaluate", heuristic, "--episodes", "1:3", "--workers", "2", PYTHONPATH=str(FAKE))
    assert "Your policy runs without the sandbox, with the same result" in there.stderr
    assert "it needs Linux" in there.stderr
    assert hash_of(there) == hash_of(run("evaluate", heuristic, "--episodes", "1:3"))


@pytest.mark.parametrize("command", ["log show", "data check", "train", "compile", "resimulate", "sensor check"])
def test_commands_load(command: str) -> None:
    assert run(*command.split(), "--help", PYTHONPATH=str(FAKE)).returncode == 0
