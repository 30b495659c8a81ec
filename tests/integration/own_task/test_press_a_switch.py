"""The task of examples/press_a_switch: all that ViTac Arena does with a task works without a change of it."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from databases import state_directory
from vitac.envs.tasks.registry import task_definitions
from vitac.evaluator.tracks import list_tracks

pytestmark = pytest.mark.slow

EXAMPLE = Path(__file__).parents[3] / "examples" / "press_a_switch"
TUTORIAL = Path(__file__).parents[3] / "docs" / "tutorials" / "press_a_switch.md"
SUBMISSION = EXAMPLE / "Switch"
LIMIT_S = 300


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of installed packages: what pip makes of the example's pyproject.toml."""
    folder = tmp_path_factory.mktemp("packages")
    project = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]
    information = folder / f"press_switch-{project['version']}.dist-info"
    information.mkdir()
    version = f"Name: {project['name']}\nVersion: {project['version']}\n"
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\n{version}")
    (group,) = project["entry-points"].items()
    points = "".join(f"{name} = {value}\n" for name, value in group[1].items())
    (information / "entry_points.txt").write_text(f"[{group[0]}]\n{points}")
    (folder / "press_switch").symlink_to(EXAMPLE / "press_switch")
    return folder


def python(packages: Path, code: str, *arguments: object, **variables: str) -> str:
    """Output of a program that finds the example's package and track, and must succeed."""
    environment = os.environ | {
        "PYTHONPATH": str(packages),
        "VITAC_TRACKS_DIR": str(EXAMPLE / "tracks"),
        "PYTHONIOENCODING": "utf-8",
        "COLUMNS": "120",
        **variables,
    }
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def vitac(packages: Path, *arguments: object, **variables: str) -> str:
    return python(packages, "from vitac.cli.main import main; main()", *arguments, **variables)


@pytest.fixture(scope="module")
def log(packages: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of an evaluation in the sandbox."""
    path = tmp_path_factory.mktemp("switch") / "switch.jsonl"
    vitac(packages, "evaluate", SUBMISSION, "--workers", 1, "--log", path, "--json", path.with_suffix(".json"))
    return path


def test_the_task_is_known_where_its_package_is_and_nowhere_else() -> None:
    assert "Switch/Press-v1" not in task_definitions()
    assert "switch" not in list_tracks()


def test_it_is_evaluated_in_the_sandbox(log: Path) -> None:
    report = json.loads(log.with_suffix(".json").read_text())
    assert report["failure"] is None
    assert (report["score"]["episodes"], report["score"]["success_rate"]) == (3, 1.0)
    starts = [(e["shape"], e["initial_offset"]) for e in report["episodes"]]
    assert starts == [("small", [4.6]), ("large", [3.3]), ("large", [1.9])]


def test_its_own_observable_is_in_the_records_and_among_the_measures(log: Path) -> None:
    records = [json.loads(line)["record"] for line in log.read_text().splitlines() if '"record"' in line]
    ends = [record["infos"][-1]["travel"] for record in records]
    measured = json.loads(log.with_suffix(".json").read_text())["score"]["measures"]["travel_mm"]
    assert measured == pytest.approx(sum(mm for (mm,) in ends) / 3)
    assert 1 < measured < 6


WRIST_POLICY = """
import numpy as np


class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        pressed_n = observation["wrist_wrench"][2]
        assert observation["taxel_forces"].shape == (2, 3, 4, 3)
        return np.array([0.7 if pressed_n < 1.0 else 0.2], dtype=np.float32)
"""


def test_a_track_of_its_own_adds_sensors_that_a_policy_presses_by(packages: Path, tmp_path: Path) -> None:
    """A file alone: neither the package nor the arena knows of it."""
    track = (EXAMPLE / "tracks" / "switch.yaml").read_text()
    added = "force_limit_n: 10\n    optional_observables: [wrist_wrench, taxel_forces]\n"
    (tmp_path / "tracks").mkdir()
    (tmp_path / "tracks" / "switch.yaml").write_text(track.replace("force_limit_n: 10\n", added))
    submission = tmp_path / "submission" / "Switch"
    submission.mkdir(parents=True)
    (submission / "policy.py").write_text(WRIST_POLICY)
    keys = "observation_keys: [wrist_wrench, taxel_forces]\n"
    (submission / "submission.yaml").write_text((SUBMISSION / "submission.yaml").read_text() + keys)
    log = tmp_path / "wrist.jsonl"
    variables = {"VITAC_TRACKS_DIR": str(tmp_path / "tracks")}
    vitac(packages, "evaluate", submission, "--workers", 1, "--log", log, "--json", tmp_path / "report", **variables)
    report = json.loads((tmp_path / "report").read_text())
    assert (report["failure"], report["score"]["success_rate"]) == (None, 1.0)
    records = [json.loads(line)["record"] for line in log.read_text().splitlines() if '"record"' in line]
    for record in records:
        ended = record["infos"][-1]
        assert ended["wrist_wrench"][2] == pytest.approx(ended["button_force_n"], abs=0.6)
    assert "verified" in vitac(packages, "log", "verify", log, **variables)


def test_its_log_is_verified(packages: Path, log: Path) -> None:
    assert "verified" in vitac(packages, "log", "verify", log)


def test_its_actions_are_re_simulated_with_its_own_measures(packages: Path, log: Path) -> None:
    output = vitac(packages, "resimulate", log, "--task", "press-switch")
    assert "Episode 2: large at 3.3" in output
    assert "  finger " in output
    assert "3 episodes, 3 successes" in output


def test_it_is_drawn_with_all_fixed_parts(packages: Path, tmp_path: Path) -> None:
    picture = tmp_path / "switch.png"
    output = vitac(packages, "show", "press-switch", "--episode", 1, "--out", picture, "--width", 600)
    assert "success after" in output
    assert picture.stat().st_size > 10_000


def test_its_expert_gives_demonstrations_that_become_a_data_set_and_replay(packages: Path, tmp_path: Path) -> None:
    """Its actions are of one number, which is what LeRobot stores otherwise than several."""
    vitac(packages, "data", "collect", "press-switch", "--successes", 1, "--out", tmp_path)
    assert '"shape":"' in (tmp_path / "press-switch" / "demonstrations.jsonl").read_text()
    pytest.importorskip("pyarrow", reason="needs the extra `data`")
    vitac(packages, "data", "export", tmp_path / "press-switch", "--to", tmp_path / "set")
    assert "1 episodes replayed" in vitac(packages, "data", "check", tmp_path / "set", "--replay", 1)


def test_it_stands_on_a_board(packages: Path) -> None:
    folders = {"VITAC_STATE_DIR": str(state_directory()), "VITAC_PORT": "0"}
    output = vitac(packages, "demo", "--exit", "--submission", SUBMISSION, **folders)
    assert "3 of 3 episodes, 3 successes" in output
    (row,) = [line.split() for line in output.splitlines() if line.split()[:2] == ["1", "demo"]]
    assert "Travel [mm]" in output
    assert float(row[-1]) == pytest.approx(2.93, abs=0.2)


def test_what_the_tutorial_shows_of_a_file_stands_in_it() -> None:
    """So what a reader sees is what the tests above play."""
    text = TUTORIAL.read_text()
    named = set(re.findall(r"`((?:press_switch|tracks|Switch)/[\w.]+|pyproject\.toml)`", text))
    assert {name for name in named if not (EXAMPLE / name).is_file()} == set()
    files = "\n".join((EXAMPLE / name).read_text() for name in sorted(named))
    shown = re.findall(
        r"^```\n(.*?)^```",
        re.sub(r"^```\w+\n.*?^```", "", text, flags=re.DOTALL | re.MULTILINE),
        re.DOTALL | re.MULTILINE,
    )
    assert len(shown) > 6
    assert [block for block in shown if block not in files] == []


def test_the_python_of_the_tutorial_works(packages: Path) -> None:
    (play,) = re.findall(r"^```python\n(import gymnasium.*?)^```", TUTORIAL.read_text(), re.DOTALL | re.MULTILINE)
    assert "success" in python(packages, play)
