"""Measures what a sensor of Track 3 costs: calibration and 270 episodes of the standard estimator, and what went wrong.

Usage: python benchmarks/sensors/cost.py [FOLDER ...] [--drawn [NAME]] [--workers 2]. Without folders, the reference gel
(162 nodes) and a flat gel of 720 nodes; with `--drawn` gels of many shapes, or one of them. No marker is lost by chance
here, so that one that is missing is a fault. Exit code 1 where a value is not finite, a marker is lost, or an IPC step
is not solved and the episode does not say so. Run it on an idle machine.
"""

import argparse
import json
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.tactile.design import SensorDesign
from vitac.envs.tactile.gel import GelCells, GelDimensions, structured_gel
from vitac.evaluator.episodes.episode import Environment, make_environment, run_episode
from vitac.evaluator.episodes.records import EpisodeOutcome, Observation
from vitac.evaluator.estimator import EstimatorSession, calibrate
from vitac.evaluator.figures.table import design_of_gel, reference_design
from vitac.evaluator.sensors.made import read_design
from vitac.evaluator.tracks import find_task

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "support" / "envs"))

import own_sensors

TASK = find_task("sensor-standard")[1]
NOT_FINITE, LOST, UNSOLVED = "values not finite", "markers lost", "IPC steps unsolved"
UNREPORTED = "episodes with unreported unsolved IPC steps"
FAULTS = (NOT_FINITE, LOST, UNREPORTED)
"""What must not happen. An unsolved IPC step may, as long as the episode ends by it."""

DRAWN: dict[str, Callable[[], SensorDesign]] = {
    **{name: partial(own_sensors.designed, name) for name in ("dome", "ridge", "pyramids", "2 mm", "8 mm")},
    "cavity": own_sensors.hollow_design,
}
"""Gels of many shapes; the one with a cavity brings its own tet.msh."""


class WatchedEnvironment:
    """An environment, and what went wrong in its present episode; no policy may hide it.

    Attributes:
        faults: how many values are not finite, how many markers are missing, and how many IPC steps are unsolved.
    """

    def __init__(self, env: Environment, markers: int) -> None:
        self._env, self._markers = env, markers
        self.faults: Counter[str] = Counter()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def reset(self, **arguments: Any) -> tuple[Observation, dict[str, Any]]:
        """Start an episode, and count from nothing."""
        self.faults.clear()
        observation, info = self._env.reset(**arguments)
        self._look(observation, info)
        return observation, info

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Play an env step."""
        stepped = self._env.step(action)
        self._look(stepped[0], stepped[-1])
        return stepped

    def _look(self, observation: Observation, info: dict[str, Any]) -> None:
        flow: Any = observation["marker_flow"]
        for values in (flow, info["surface_diff_m"]):
            self.faults[NOT_FINITE] += int((~np.isfinite(values)).sum())
        self.faults[LOST] += sum(self._markers - len(np.unique(sensor[0], axis=0)) for sensor in flow)
        self.faults[UNSOLVED] += sum(report.status is StepStatus.NOT_CONVERGED for report in info["step_reports"])


def counted(faults: Counter[str], outcome: EpisodeOutcome) -> Counter[str]:
    """Return the counts of an episode, which reports unsolved IPC steps by ending as `not_converged`."""
    is_silent = faults[UNSOLVED] > 0 and outcome is not EpisodeOutcome.NOT_CONVERGED
    return +faults + Counter([outcome.value, *[UNREPORTED] * is_silent])


def play(number: int) -> tuple[Counter[str], float]:
    """Play one episode in a process of the pool; return what was counted, and the CPU time [s]."""
    begun_s = process_time()
    env, session = state["env"], state["session"]
    record = run_episode(env=env, task=TASK, episode=TASK.episodes[number - 1], open_session=lambda: session)
    return counted(env.faults, record.outcome), process_time() - begun_s


def measure(name: str, design: SensorDesign, workers: int) -> dict[str, Any]:
    """Calibrate the estimator to a sensor and play the whole list."""
    started, begun_s = perf_counter(), process_time()
    coefficients = calibrate(make_environment(TASK, sensor=design), TASK)
    calibration_s, calibration_cpu_s = perf_counter() - started, process_time() - begun_s
    started = perf_counter()
    plain: Any = make_environment(TASK, sensor=design)
    markers = replace(plain.settings.markers, loss_probability=0.0)
    lossless = make_environment(TASK, sensor=design, settings={"markers": markers})
    session = EstimatorSession(coefficients, TASK.definition.action_scale, is_blind=False)
    state.update(env=WatchedEnvironment(lossless, len(design.markers_mm)), session=session)
    with ProcessPoolExecutor(workers, mp_context=get_context("fork")) as pool:
        played = list(pool.map(play, [episode.number for episode in TASK.episodes], chunksize=9))
    return {
        "sensor": name,
        "nodes": len(design.gel.rest_position_m),
        "calibration_s": round(calibration_s, 1),
        "calibration_cpu_s": round(calibration_cpu_s, 1),
        "episodes": len(played),
        "episodes_s": round(perf_counter() - started, 1),
        "episodes_cpu_s": round(sum(cpu_s for _, cpu_s in played), 1),
        **sum((counts for counts, _ in played), Counter[str]()),
    }


def flat_gel(cells: GelCells) -> SensorDesign:
    """Return a flat gel with the default camera and markers."""
    return design_of_gel(structured_gel(name="flat", size=GelDimensions(), cells=cells))


def chosen(arguments: argparse.Namespace) -> Iterable[tuple[str, SensorDesign]]:
    """Yield the sensors that the command names."""
    for folder in arguments.folders:
        yield str(folder), read_design(folder)
    for name in DRAWN if arguments.drawn == "all" else filter(None, [arguments.drawn]):
        yield name, DRAWN[name]()
    if not arguments.folders and arguments.drawn is None:
        yield "reference gel", reference_design()
        yield "flat gel of 720 nodes", flat_gel(GelCells(x=13, y=12, bevel=1, layers=2))


def main() -> None:
    """Measure, and print a line of JSON for each sensor."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--drawn", nargs="?", const="all", choices=[*DRAWN, "all"])
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    # Compiles what is not in the cache yet.
    calibrate(make_environment(TASK, sensor=reference_design()), TASK, starts=2)
    faulty = []
    for name, design in chosen(arguments):
        measured = measure(name, design, arguments.workers)
        print(json.dumps(measured), flush=True)
        faulty += [f"{name}: {measured[fault]} {fault}" for fault in FAULTS if fault in measured]
    if faulty:
        sys.exit("\n".join(faulty))


state: dict[str, Any] = {}

if __name__ == "__main__":
    main()
