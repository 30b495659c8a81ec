"""Measures what a sensor of Track 3 costs: calibration and 270 episodes of the standard estimator, and what went wrong.

Usage: python benchmarks/sensors/cost.py [FOLDER ...] [--workers 2]. Without folders, the reference gel (162 nodes)
and a flat gel of 720 nodes. No marker is lost by chance here, so that one that is missing is a fault. Run it on an idle
machine.
"""

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from vitac.envs.tactile.design import SensorDesign
from vitac.envs.tactile.gel import GelCells, GelDimensions, structured_gel
from vitac.evaluator.episodes.episode import make_environment, run_episode
from vitac.evaluator.episodes.reading import Observation
from vitac.evaluator.estimator.calibration import calibrate
from vitac.evaluator.estimator.playing import EstimatorPolicy, EstimatorSession
from vitac.evaluator.figures.reference import design_of_gel, reference_design
from vitac.evaluator.sensors.made import design_in
from vitac.evaluator.tracks import find_task

TASK = find_task("sensor-standard")[1]


class Watched:
    """The estimator, and how many markers of what it sees are not finite or missing."""

    def __init__(self, policy: EstimatorPolicy, markers: int) -> None:
        self._policy, self._markers = policy, markers
        self.faults: Counter[str] = Counter()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._policy, name)

    def act(self, observation: Observation) -> Any:
        """Look at the markers, then let the estimator act."""
        flow: Any = observation["marker_flow"]
        self.faults["not finite"] += int((~np.isfinite(flow)).sum())
        for sensor in flow:
            self.faults["lost markers"] += self._markers - len(np.unique(sensor[0], axis=0))
        return self._policy.act(observation)


class WatchedSession(EstimatorSession):
    """The estimator, watched in all episodes."""

    markers = 0

    @contextmanager
    def episode(self, **arguments: Any) -> Iterator[Any]:
        """Return the estimator for one episode."""
        with super().episode(**arguments) as policy:
            self.watched = Watched(policy, self.markers)
            yield self.watched


def play(number: int) -> tuple[Counter[str], float]:
    """Play one episode in a process of the pool; return what was counted, and the CPU time [s]."""
    begun_s = process_time()
    env, session = state["env"], state["session"]
    record = run_episode(env=env, task=TASK, episode=TASK.episodes[number - 1], open_session=lambda: session)
    motions_m = np.array([info["surface_diff_m"] for info in record.infos], dtype=np.float64)
    faults = session.watched.faults + Counter({"not finite": int((~np.isfinite(motions_m)).sum())})
    return faults + Counter({record.outcome.value: 1}), process_time() - begun_s


def measure(name: str, design: SensorDesign, workers: int) -> dict[str, Any]:
    """Calibrate the estimator to a sensor and play the whole list."""
    started, begun_s = perf_counter(), process_time()
    coefficients = calibrate(make_environment(TASK, sensor=design), TASK)
    calibration_s, calibration_cpu_s = perf_counter() - started, process_time() - begun_s
    started = perf_counter()
    plain: Any = make_environment(TASK, sensor=design)
    markers = replace(plain.settings.markers, loss_probability=0.0)
    session = WatchedSession(coefficients, TASK.definition.action_scale, is_blind=False)
    session.markers = len(design.markers_mm)
    state.update(env=make_environment(TASK, sensor=design, settings={"markers": markers}), session=session)
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


def main() -> None:
    """Measure, and print a line of JSON for each sensor."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    # Compiles what is not in the cache yet.
    calibrate(make_environment(TASK, sensor=reference_design()), TASK, starts=2)
    designs = {str(folder): design_in(folder) for folder in arguments.folders} or {
        "reference gel": reference_design(),
        "flat gel of 720 nodes": flat_gel(GelCells(x=13, y=12, bevel=1, layers=2)),
    }
    for name, design in designs.items():
        print(json.dumps(measure(name, design, arguments.workers)), flush=True)


state: dict[str, Any] = {}

if __name__ == "__main__":
    main()
