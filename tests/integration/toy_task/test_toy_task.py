"""A third task in a package of its own: everything that ViTac Arena does with a task works without a change of it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from databases import state_directory
from vitac.envs.tasks.registry import task_definitions
from vitac.evaluator.tracks import list_tracks

HERE = Path(__file__).parent
SUBMISSION = HERE / "submission"
LIMIT_S = 300


def vitac(*arguments: object, **variables: str) -> str:
    """Output of a command that finds the toy's package and track, and must succeed."""
    environment = os.environ | {
        "PYTHONPATH": str(HERE / "packages"),
        "VITAC_TRACKS_DIR": str(HERE / "tracks"),
        "PYTHONIOENCODING": "utf-8",
        "COLUMNS": "120",
        **variables,
    }
    done = subprocess.run(
        [sys.executable, "-c", "from vitac.cli.main import main; main()", *map(str, arguments)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of an evaluation in the sandbox."""
    path = tmp_path_factory.mktemp("toy") / "toy.jsonl"
    vitac("evaluate", SUBMISSION, "--workers", 1, "--log", path, "--json", path.with_suffix(".json"))
    return path


def test_the_toy_is_known_where_its_package_is_and_nowhere_else() -> None:
    assert "Toy/Lift-v1" not in task_definitions()
    assert "toy" not in list_tracks()


def test_it_is_evaluated_in_the_sandbox(log: Path) -> None:
    report = json.loads(log.with_suffix(".json").read_text())
    assert report["failure"] is None
    assert (report["score"]["episodes"], report["score"]["success_rate"]) == (3, 1.0)
    assert [(e["shape"], e["initial_offset"], e["env_steps"]) for e in report["episodes"]] == [
        ("low", [0.0], 3),
        ("high", [2.5], 3),
        ("high", [-4.0], 3),
    ]


def test_its_log_is_verified(log: Path) -> None:
    assert "verified" in vitac("log", "verify", log)


def test_its_actions_are_re_simulated_with_its_own_measures(log: Path) -> None:
    output = vitac("resimulate", log, "--task", "toy-lift")
    assert "Episode 2: high at 2.5" in output
    assert "  block " in output
    assert "3 episodes, 3 successes" in output


def test_it_is_drawn(tmp_path: Path) -> None:
    output = vitac("show", "toy-lift", "--episode", 1, "--out", tmp_path / "toy.png", "--width", 600)
    assert "success after 3 env steps" in output
    assert (tmp_path / "toy.png").stat().st_size > 10_000


@pytest.mark.slow
def test_it_stands_on_a_board() -> None:
    output = vitac("demo", "--exit", "--submission", SUBMISSION, VITAC_STATE_DIR=str(state_directory()), VITAC_PORT="0")
    assert "3 of 3 episodes, 3 successes" in output
    assert any(line.split()[:2] == ["1", "demo"] for line in output.splitlines())
