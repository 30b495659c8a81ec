"""Are the variants hard, and not broken? Plays each on lists made from secrets of their own.

python benchmarks/variants/headroom.py peg-insertion-robust [--starts 150] [--secret FILE] --json FILE

The example must stay below 60 %, a planner with the truth, which simulates ahead, above 95 %. Each quantity's range is
cut into equal parts, in which the example's success must be monotone within the 95 % intervals.
"""

import argparse
import json
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from one_at_a_time import POLICIES, sealed_task
from players import Example, Planner
from vitac.envs.tasks.quantities import Quantity
from vitac.evaluator.scoring.comparison import RateOfPart, rates_by_draw
from vitac.evaluator.scoring.score import rate
from vitac.evaluator.tracks import Task
from vitac.evaluator.tracks.sealed import make_commitment, read_secret


def main() -> None:
    """Play, print the rates and write the episodes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", choices=POLICIES)
    parser.add_argument("--starts", type=int, default=150)
    parser.add_argument("--secret", type=Path)
    parser.add_argument("--json", type=Path, required=True)
    chosen = parser.parse_args()
    secret = read_secret(chosen.secret) if chosen.secret else secrets.token_bytes(32)
    task = sealed_task(chosen.task, secret)
    named, folder = POLICIES[chosen.task]
    example, planner = Example(task, folder, named=named), Planner(task)
    episodes: list[dict[str, Any]] = []
    for episode in task.episodes[: chosen.starts]:
        played, planned = example.play(episode.options), planner.play(episode.options)
        ends = {"example": played["end_reason"], "truth": planned["end_reason"]}
        episodes.append({"draws": planned["draws"], **ends})
        print(json.dumps({"shape": episode.shape, "offset": episode.offset, **episodes[-1]}), flush=True)
    found = {
        "task": task.name,
        "commitment": make_commitment(secret),
        "players": {player: successes(episodes, player) for player in ("example", "truth")},
        "by_draw": {quantity.name: measure_by_draw(task, quantity, episodes) for quantity in task.drawn_quantities},
    }
    print(json.dumps(found["players"], indent=1))
    chosen.json.write_text(json.dumps(found, indent=1) + "\n")


def measure_by_draw(task: Task, quantity: Quantity, episodes: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the example's success in each part of a quantity's range, and whether it is monotone."""
    ends = [
        (episode["draws"][quantity.name], start, episode["example"] == "success")
        for start, episode in enumerate(episodes)
    ]
    parts = rates_by_draw(quantity, task.draws[quantity.name], ends)
    return {"monotone": is_monotone(parts), "parts": [part.model_dump() for part in parts]}


def is_monotone(parts: Sequence[RateOfPart]) -> bool:
    """Return whether a rate that only rises, or only falls, lies within the 95 % interval of every part."""
    return _can_rise(parts) or _can_rise(parts[::-1])


def _can_rise(parts: Sequence[RateOfPart]) -> bool:
    least = 0.0
    for part in parts:
        least = max(least, part.rate.interval.low)
        if least > part.rate.interval.high:
            return False
    return True


def successes(episodes: list[dict[str, Any]], player: str) -> dict[str, Any]:
    """Return the rate of a player, and how often it ended how."""
    ends = [episode[player] for episode in episodes]
    found = rate(ends.count("success"), len(ends)).model_dump()
    return {**found, "ends": {end: ends.count(end) for end in sorted(set(ends))}}


if __name__ == "__main__":
    main()
