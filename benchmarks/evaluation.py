"""Measures the evaluation of the example policy on the whole list, by parts.

Run it as `python benchmarks/evaluation.py [--workers 2] [--json FILE]` on idle cores, one for each worker. What the
service adds is not in it. `wall_over_physics` is the time of all workers for each second of physics: aim 1.35.
"""

import argparse
import json
from pathlib import Path
from time import perf_counter
from typing import Any

from vitac.evaluator.evaluation.local import LocalEvaluation, evaluate
from vitac.evaluator.submission.sources import staged
from vitac.evaluator.tracks import find_task

EXAMPLE = Path(__file__).parents[1] / "examples" / "peg_insertion_heuristic"
PARTS = ("physics", "markers", "policy", "channel")


def main() -> None:
    """Evaluate once to compile the kernels and once to measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    arguments = parser.parse_args()
    with staged(EXAMPLE) as submission:
        play(submission, workers=1, episodes=(1,))
        started = perf_counter()
        evaluation = play(submission, workers=arguments.workers)
        wall_s = perf_counter() - started
    numbers = split(evaluation, wall_s, arguments.workers)
    for name, value in numbers.items():
        print(f"{name:24} {value:8.3f}" if isinstance(value, float) else f"{name:24} {value:>8}")
    if arguments.json:
        arguments.json.write_text(json.dumps(numbers, indent=1) + "\n")


def play(submission: Path, workers: int, episodes: tuple[int, ...] | None = None) -> LocalEvaluation:
    """Evaluate the peg task."""
    track, task = find_task("peg-insertion")
    return evaluate(submission_dir=submission, track=track, task=task, workers=workers, episodes=episodes)


def split(evaluation: LocalEvaluation, wall_s: float, workers: int) -> dict[str, Any]:
    """Return the time of each part [s], summed over the processes.

    `other` is loading the policy, copying it, waiting and other Python; `outside_episodes`: loading the simulation in
    one process while the others wait, starts and ends of shards.
    """
    timings = [record.timings for record in evaluation.records]
    parts = {f"{part}_s": sum(float(getattr(timing, f"{part}_s")) for timing in timings) for part in PARTS}
    episodes_s = sum(timing.wall_s for timing in timings)
    env_steps = sum(record.env_steps for record in evaluation.records)
    return {
        "workers": workers,
        "wall_s": wall_s,
        "wall_over_physics": workers * wall_s / parts["physics_s"],
        "episodes": len(timings),
        "env_steps": env_steps,
        "episodes_wall_s": episodes_s,
        **parts,
        "other_s": episodes_s - sum(parts.values()),
        "outside_episodes_s": workers * wall_s - episodes_s,
        "result_hash": evaluation.result_hash,
    }


if __name__ == "__main__":
    main()
