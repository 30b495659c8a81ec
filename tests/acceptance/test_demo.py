"""The product's front door: `vitac demo --exit` with the real physics, sandbox, queue and pages."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from databases import state_directory

LIMIT_S = 900  # on a machine that does other work at the same time
MAIN = "from vitac.cli.main import main; main()"


def vitac(*arguments: str, state: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"VITAC_STATE_DIR": str(state), "VITAC_PORT": "0", "PYTHONIOENCODING": "utf-8"}
    return subprocess.run(
        [sys.executable, "-c", MAIN, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )


@pytest.mark.slow
def test_the_example_reaches_the_leaderboard(repository: Path) -> None:
    example = repository / "examples" / "peg_insertion_heuristic"
    ran = vitac("demo", "--exit", "--submission", str(example), state=state_directory())
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "270 of 270 episodes" in ran.stdout
    row = next(line for line in ran.stdout.splitlines() if line.split()[:2] == ["1", "demo"])
    assert "●" in row


@pytest.mark.slow
def test_agent_of_a_station_plays_three_trials_and_both_gels_are_on_a_page(repository: Path) -> None:
    state = state_directory()
    submission = repository / "examples" / "peg_insertion_trained"
    played = vitac("demo", "--station", "--submission", str(submission), state=state)
    assert played.returncode == 0, played.stdout + played.stderr
    assert "of 3 succeeded" in played.stdout
    page = state / "station" / "pictures" / "index.html"
    assert page.as_uri() in played.stdout
    shown = page.read_text(encoding="utf-8")
    assert all(f"Trial {number}: " in shown for number in (1, 2, 3))
    assert shown.count("<img ") >= 3 * 3
