"""Measures the figures of the reference gel and writes them to `evaluator/figures/reference.json`, its looks beside.

Usage: python benchmarks/reference/sensor_figures.py. Takes about 80 s of CPU time. Commit the file when the definitions
of the figures or the physics have changed.
"""

import os
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context

from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.estimator import calibrate
from vitac.evaluator.figures.figures import FiguresPart, StartFigures, merged
from vitac.evaluator.figures.starts import Measurement, measured_episodes
from vitac.evaluator.figures.table import FILE, LOOKS, make_reference_looks, reference_design
from vitac.evaluator.tracks import load_track


@cache
def measurement() -> Measurement:
    """Return what measures the reference gel in this process, calibrated."""
    design = reference_design()
    return Measurement(TASK, design, calibrate(make_environment(TASK, sensor=design), TASK))


def start(number: int) -> StartFigures:
    """Return what is measured at the start of an episode."""
    return measurement().start(TASK.episodes[number - 1])


def main() -> None:
    """Measure, and write the file."""
    whole = measurement().whole()
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), mp_context=get_context("fork")) as pool:
        starts = tuple(pool.map(start, sorted(measured_episodes(TASK))))
    part = FiguresPart(starts=starts, touch=whole.touch, grasp=whole.grasp)
    figures = merged([part], [found.offset for found in TASK.episode_list.starts])
    if figures is None:
        raise SystemExit("expected figures from a whole measurement")
    LOOKS.write_text(make_reference_looks().model_dump_json() + "\n", encoding="utf-8")
    FILE.write_text(figures.model_dump_json() + "\n", encoding="utf-8")
    print(FILE, figures.digest)


TASK = next(task for task in load_track("track_3").tasks.values() if task.measures_figures)

if __name__ == "__main__":
    main()
