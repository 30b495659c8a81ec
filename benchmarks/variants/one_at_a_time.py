"""How much does each drawn quantity take from an example policy?

python benchmarks/variants/one_at_a_time.py TASK [--starts 60] [--secret FILE] [--only QUANTITY ...] --json FILE

Every row plays the same starts of a list made from a secret, all other quantities at the values of the 2025 evaluation.
The secret is a fresh one without `--secret`.
"""

import argparse
import json
import secrets
from pathlib import Path
from typing import Any

from players import EXAMPLES, Example
from vitac.envs.tasks.quantities import Quantity
from vitac.evaluator.scoring.score import rate
from vitac.evaluator.tracks import Task
from vitac.evaluator.tracks.registry import find_task
from vitac.evaluator.tracks.sealed import read_secret, sealed_track

POLICIES = {
    name: (played, EXAMPLES / folder)
    for name, played, folder in (
        ("peg-insertion-robust", "peg-insertion", "peg_insertion_arena/Track_1"),
        ("lock-opening-robust", "lock-opening", "lock_opening_trained/Track_1"),
        ("fusion-robust", "fusion-insertion", "track_2_fusion/Track_2"),
        ("explore-robust", "explore", "explore_scripted/Explore"),
        ("moving-hole-robust", "peg-insertion", "peg_insertion_arena/Track_1"),
        ("in-hand-turn-robust", "in-hand-turn", "in_hand_turn_cloned/InHandTurn"),
        ("slip-robust", "slip", "slip_scripted/Slip"),
        ("soft-plug-robust", "soft-plug", "soft_plug_scripted/SoftPlug"),
        ("cable-end-robust", "cable-end", "cable_end_scripted/CableEnd"),
        ("assembly-robust", "assembly", "assembly_cloned/Assembly"),
    )
}
"""Name by which each variant's example knows the task, and its folder."""

Row = dict[str, Any]


def main() -> None:
    """Play and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", choices=POLICIES)
    parser.add_argument("--starts", type=int, default=60)
    parser.add_argument("--secret", type=Path)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--json", type=Path, required=True)
    chosen = parser.parse_args()
    task = sealed_task(chosen.task, read_secret(chosen.secret) if chosen.secret else secrets.token_bytes(32))
    rows = [row(task, {}, chosen.starts)]
    for quantity in task.drawn_quantities:
        if chosen.only and quantity.name not in chosen.only:
            continue
        for value in values(quantity, task.draws[quantity.name]):
            rows.append(row(task, {quantity.name: value}, chosen.starts))
            chosen.json.write_text(json.dumps(rows, indent=1) + "\n")


def sealed_task(name: str, secret: bytes) -> Task:
    """Return a task with the list of a secret."""
    track, _ = find_task(name)
    return sealed_track(track, secret).tasks[name]


def values(quantity: Quantity, limits: tuple[float, float]) -> list[float]:
    """Return the ends of a range that are not the nominal value, one where both sides are equally hard."""
    ends = [limit for limit in limits if limit != quantity.nominal]
    return ends[-1:] if quantity.two_sided else ends


def row(task: Task, fixed: dict[str, float], starts: int) -> Row:
    """Return the successes of the example with these quantities fixed."""
    named, folder = POLICIES[task.name]
    example = Example(task, folder, named=named, draws={name: (value, value) for name, value in fixed.items()})
    infos = [example.play(episode.options) for episode in task.episodes[:starts]]
    solved = rate(sum(info["is_success"] for info in infos), len(infos))
    found: Row = {"fixed": fixed, "example": solved.model_dump()}
    print(json.dumps(found), flush=True)
    return found


if __name__ == "__main__":
    main()
