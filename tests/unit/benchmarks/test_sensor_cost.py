"""benchmarks/sensors/cost.py: nothing that goes wrong in an episode is overlooked, and the command fails by it."""

import json
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import drawn_gels
import numpy as np
import pytest
from own_sensors import write_sensor
from sensors import cost
from vitac.envs.fem.scene.report import StepStatus
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.figures.table import reference_design

MARKERS = 5


class Scripted:
    """An environment that shows what it is given: a marker flow, surface motions, and how IPC steps ended."""

    solver_version = "scripted"

    def __init__(self) -> None:
        reference = np.stack([np.arange(MARKERS), np.arange(MARKERS) ** 2], axis=-1)
        self.flow = np.broadcast_to(reference, (2, 2, MARKERS, 2)).astype(np.float32)
        self.motions_m = np.array([1e-3, 1e-3])
        self.statuses = [StepStatus.CONVERGED, StepStatus.DIVIDED, StepStatus.ESCAPED_SADDLE]

    def reset(self, **_: Any) -> tuple[Any, Any]:
        """Show it."""
        reports = [SimpleNamespace(status=status) for status in self.statuses]
        return {"marker_flow": self.flow}, {"surface_diff_m": self.motions_m, "step_reports": reports}

    def step(self, _: Any) -> tuple[Any, ...]:
        """Show it."""
        observation, info = self.reset()
        return observation, 0.0, False, False, info


@pytest.fixture
def scripted() -> Scripted:
    """Nothing is wrong in it."""
    return Scripted()


def watched(scripted: Scripted) -> Any:
    return cost.WatchedEnvironment(scripted, MARKERS)  # type: ignore[arg-type]


def test_sound_episodes_have_no_faults_and_the_environment_is_seen_through(scripted: Scripted) -> None:
    env = watched(scripted)
    env.reset(options={})
    env.step(None)
    assert not +env.faults
    assert env.solver_version == "scripted"


def test_every_value_that_is_not_finite_is_counted(scripted: Scripted) -> None:
    env = watched(scripted)
    env.reset(options={})
    scripted.flow = scripted.flow.copy()
    scripted.flow[0, 1, 2] = np.nan, np.inf
    scripted.motions_m = np.array([np.nan, 0.0])
    env.step(None)
    assert +env.faults == {cost.NOT_FINITE: 3}


def test_markers_that_another_one_stands_for_are_counted_in_both_sensors(scripted: Scripted) -> None:
    scripted.flow = scripted.flow.copy()
    scripted.flow[:, :, -1] = scripted.flow[:, :, -2]
    env = watched(scripted)
    env.reset(options={})
    assert +env.faults == {cost.LOST: 2}


def test_each_episode_is_counted_from_nothing(scripted: Scripted) -> None:
    scripted.statuses = [StepStatus.NOT_CONVERGED, StepStatus.CONVERGED, StepStatus.NOT_CONVERGED]
    env = watched(scripted)
    env.reset(options={})
    assert +env.faults == {cost.UNSOLVED: 2}
    scripted.statuses = []
    env.reset(options={})
    assert not +env.faults


@pytest.mark.parametrize("outcome", EpisodeOutcome)
def test_unsolved_ipc_steps_are_unreported_where_the_episode_ends_by_something_else(outcome: EpisodeOutcome) -> None:
    found = cost.counted(Counter({cost.UNSOLVED: 3, cost.LOST: 0}), outcome)
    expected = {cost.UNSOLVED: 3, outcome.value: 1}
    if outcome is not EpisodeOutcome.NOT_CONVERGED:
        expected[cost.UNREPORTED] = 1
    assert found == expected
    assert cost.counted(Counter(), outcome) == {outcome.value: 1}


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Runs the command without playing anything; `faults` are those of the sensors, by name."""

    def main(*arguments: str, faults: dict[str, dict[str, int]] | None = None) -> None:
        def measure(name: str, design: Any, workers: int) -> dict[str, Any]:
            n_nodes = len(design.gel.rest_position_m)
            return {"sensor": name, "nodes": n_nodes, "workers": workers, **(faults or {}).get(name, {})}

        monkeypatch.setattr(cost, "measure", measure)
        monkeypatch.setattr(cost, "calibrate", lambda *_, **__: None)
        monkeypatch.setattr("sys.argv", ["cost.py", *arguments])
        cost.main()

    return main


def measured(text: str) -> list[tuple[str, int, int]]:
    return [(line["sensor"], line["nodes"], line["workers"]) for line in map(json.loads, text.splitlines())]


def test_without_sensors_the_reference_and_the_large_gel_are_measured(
    run: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    run()
    assert measured(capsys.readouterr().out) == [("reference gel", 162, 2), ("flat gel of 720 nodes", 720, 2)]


def test_folders_and_one_drawn_gel_are_measured_where_they_are_named(
    run: Any, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder = write_sensor(tmp_path, drawn_gels.flat(4.0))
    run(str(folder), "--drawn", "cavity", "--workers", "1")
    (flat, nodes, _), (cavity, *_) = measured(capsys.readouterr().out)
    assert (flat, cavity) == (str(folder), "cavity")
    assert nodes >= 250


def test_a_fault_makes_the_command_fail_after_all_sensors_and_an_unsolved_step_does_not(
    run: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cost, "DRAWN", dict.fromkeys(("dome", "ridge", "2 mm"), reference_design))
    faults = {"dome": {cost.LOST: 4, cost.NOT_FINITE: 1}, "ridge": {cost.UNSOLVED: 2}, "2 mm": {cost.UNREPORTED: 1}}
    with pytest.raises(SystemExit) as ended:
        run("--drawn", faults=faults)
    assert ended.value.code == (
        "dome: 1 values not finite\ndome: 4 markers lost\n2 mm: 1 episodes with unreported unsolved IPC steps"
    )
    assert [name for name, *_ in measured(capsys.readouterr().out)] == ["dome", "ridge", "2 mm"]
    run("--drawn", "ridge", faults=faults)
