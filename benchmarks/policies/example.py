"""Compares the example policies with no motion and random actions, on random starts and on the public list.

Usage: PYTHONPATH=benchmarks python benchmarks/policies/example.py [--task TASK] [--starts N] [--json FILE]

Random starts come from a seed that no example was made with.
"""

import argparse
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from trained_policy import name_start
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.scoring.score import Rate, rate_by_start
from vitac.evaluator.tracks import Task, load_track

EXAMPLES = Path(__file__).parents[2] / "examples"
FOLDERS = {"peg-insertion": "peg_insertion_heuristic", "lock-opening": "lock_opening_heuristic"}
STARTS = 270
SEED = 2
Act = Callable[[Mapping[str, Any]], NDArray[np.float32]]
MakeAct = Callable[[int], Act]


def main() -> None:
    """Run the three policies of each task from the same starts and print their success rates."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", choices=FOLDERS, action="append", help="all by default")
    parser.add_argument("--starts", type=int, default=STARTS, help="random starts")
    parser.add_argument("--json", type=Path, help="write the rates to this file")
    arguments = parser.parse_args()
    track = load_track("track_1")
    content = {name: compared(track.tasks[name], arguments.starts) for name in arguments.task or FOLDERS}
    if arguments.json:
        arguments.json.write_text(json.dumps(content, indent=1) + "\n")


def compared(task: Task, starts: int) -> dict[str, Any]:
    """Return the rates of all policies on both sets of starts, printing each as soon as it is known."""
    sets: dict[str, list[Mapping[str, object]]] = {
        "random starts": [{"rng_seed": (SEED, number)} for number in range(starts)],
        "public list": [episode.options for episode in task.episodes],
    }
    content: dict[str, Any] = {}
    for where, options in sets.items():
        print(f"{task.name}, {len(options)} starts: {where}")
        results = {name: play(task, name, options, make) for name, make in actors(task).items()}
        beaten = all(results["example"].interval.low > results[name].interval.high for name in ("zero", "random"))
        print("  The example's interval lies above both others." if beaten else "  The intervals overlap.")
        content[where] = {name: result.model_dump() for name, result in results.items()}
    return content


def actors(task: Task) -> dict[str, MakeAct]:
    """Return the policies by name."""
    size = len(task.actions)

    def anything(number: int) -> Act:
        random = np.random.default_rng([SEED, number])
        return lambda _: random.uniform(-1, 1, size).astype(np.float32)

    return {
        "example": example(task.name),
        "zero": lambda _: lambda _: np.zeros(size, dtype=np.float32),
        "random": anything,
    }


def example(task: str) -> MakeAct:
    """Return the task's example policy."""
    policy = run_path(str(EXAMPLES / FOLDERS[task] / "Track_1" / "policy.py"))["Policy"]()

    def begun(_: int) -> Act:
        policy.reset(task)
        act: Act = policy.act
        return act

    return begun


def play(task: Task, name: str, starts: Iterable[Mapping[str, object]], make: MakeAct) -> Rate:
    """Return the success rate of one policy; print it with the mean env steps of its successes."""
    env = make_environment(task)
    ends = [(name_start(options), episode(env, options, make(number))) for number, options in enumerate(starts)]
    solved = [length for _, length in ends if length]
    result = rate_by_start((start, length > 0) for start, length in ends)
    interval = f"[{result.interval.low:.1%}, {result.interval.high:.1%}]"
    steps = f", {sum(solved) / len(solved):.2f} env steps" if solved else ""
    print(f"  {name:8} {result.successes:3} {result.success_rate:6.1%}  {interval}{steps}", flush=True)
    return result


def episode(env: Any, options: Mapping[str, object], act: Act) -> int:
    """Run an episode; return the env steps of a success, 0 for any other outcome."""
    observation, _ = env.reset(options=options)
    length = 0
    while True:
        observation, _, terminated, truncated, _ = env.step(act(observation))
        length += 1
        if terminated or truncated:
            return length if terminated else 0


if __name__ == "__main__":
    main()
