"""Plays every baseline of Track 1 from fresh random starts and on the public list, and writes `baselines.md`.

PYTHONPATH=benchmarks python benchmarks/policies/baselines.py [--starts 300] [--seed 1] [--out benchmarks/baselines.md]

Fresh starts are those of the stream for reports, which no baseline learned from. Policies play in this process; the
official score of the public list is that of `vitac evaluate`, in the sandbox.
"""

import argparse
import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from runpy import run_path
from statistics import fmean
from typing import Any

from trained_policy import figures, fresh_starts, public_starts
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.scoring.score import interval_of_seeds, rate
from vitac.evaluator.tracks import load_track
from vitac.training.streams import Use, stream

EXAMPLES = Path(__file__).parents[2] / "examples"
BASELINES = {
    "peg-insertion": ("peg_insertion_trained", "peg_insertion_heuristic"),
    "lock-opening": ("lock_opening_trained", "lock_opening_heuristic", "lock_opening_cloned"),
}
HEAD = """# Baselines

Written by `PYTHONPATH=benchmarks python benchmarks/policies/baselines.py`; successes in % with 95 %
intervals, which count starts, env steps of successes, and CPU time of an episode with its policy and physics, on the
machine that wrote it. Fresh starts are random ones that no baseline learned from (stream {stream}).

| task | baseline | {starts} fresh starts | env steps | public list | env steps | CPU ms per episode |
|---|---|---|---|---|---|---|
"""
SHAPES = """
## By shape
Successes on the public list, which the boards show in the baselines' rows; in brackets of how many starts no repeat was
solved, of how many one, and so on.

| task | baseline | shapes |
|---|---|---|
"""
SEEDS = """
## Training seeds
The trained baselines again with other seeds of the same recipe, as `figures.json` of each example has them. Each seed
plays 300 fresh starts of its own, so that only the public list compares seeds. Seed 1 is shipped. The interval of the
mean counts seeds.

| task | baseline | seed | fresh starts | env steps | public list | solved | env steps |
|---|---|---|---|---|---|---|---|
"""


@dataclass(frozen=True, kw_only=True)
class Row:
    """A baseline's figures.

    Attributes:
        task: of the list.
        name: of the example's folder.
        fresh: figures from fresh starts.
        public: figures of the public list.
        cpu_s: of all these episodes.
    """

    task: str
    name: str
    fresh: Mapping[str, Any]
    public: Mapping[str, Any]
    cpu_s: float


def main() -> None:
    """Play all baselines and write the table."""
    parser = argparse.ArgumentParser(description="all baselines of Track 1")
    parser.add_argument("--starts", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1, help="of the stream of fresh starts")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "baselines.md")
    chosen = parser.parse_args()
    rows = [row for task in BASELINES for row in make_rows(task, chosen.seed, chosen.starts)]
    head = HEAD.format(stream=stream(chosen.seed, Use.REPORT), starts=chosen.starts)
    seeds = "".join(map(seed_lines, training_seeds()))
    shapes = "".join(map(shapes_line, rows))
    chosen.out.write_text(head + "".join(map(line, rows)) + SHAPES + shapes + SEEDS + seeds)


def make_rows(task: str, seed: int, starts: int) -> list[Row]:
    """Return the figures of all baselines of a task."""
    env: Any = make_environment(load_track("track_1").tasks[task])
    rows = []
    for name in BASELINES[task]:
        policy = load_policy(EXAMPLES / name)
        began = time.process_time()
        fresh = figures(env, policy, fresh_starts(seed, starts), task)
        public = figures(env, policy, public_starts(task), task)
        rows.append(Row(task=task, name=name, fresh=fresh, public=public, cpu_s=time.process_time() - began))
    return rows


def load_policy(example: Path) -> Any:
    """Return the policy of an example, in this process."""
    return run_path(str(example / "Track_1" / "policy.py"))["Policy"]()


def line(row: Row) -> str:
    """Return the line of the table."""
    episodes = row.fresh["episodes"] + row.public["episodes"]
    cells = [row.task, row.name]
    for found in (row.fresh, row.public):
        cells += [percent(found), f"{found['mean_steps']:.2f}" if found["successes"] else "-"]
    return f"| {' | '.join(cells)} | {1000 * row.cpu_s / episodes:.0f} |\n"


def shapes_line(row: Row) -> str:
    """Return the line with the successes by shape."""
    shapes = (
        f"{shape} {rate['successes']} of {rate['episodes']} ({' '.join(map(str, rate['solved_of_start']))})"
        for shape, rate in row.public["by_shape"].items()
    )
    return f"| {row.task} | {row.name} | {', '.join(shapes)} |\n"


def training_seeds() -> Iterator[tuple[str, str, Mapping[str, Mapping[str, Any]]]]:
    """Yield task and baseline with the figures of its training runs by seed, the one that is shipped first."""
    for task, names in BASELINES.items():
        for name in names:
            path = EXAMPLES / name / "figures.json"
            if path.exists():
                shipped = json.loads(path.read_text())
                yield task, name, {"1": shipped, **shipped["seeds"]}


def seed_lines(runs: tuple[str, str, Mapping[str, Mapping[str, Any]]]) -> str:
    """Return the lines of the training runs of a baseline, and of their mean."""
    task, name, by_seed = runs
    lines = [
        [
            seed,
            f"{100 * found['fresh']['success_rate']:.1f}",
            f"{found['fresh']['mean_steps']:.2f}",
            f"{100 * found['public']['success_rate']:.1f}",
            f"{found['public']['successes']} of {found['public']['episodes']}",
            f"{found['public']['mean_steps']:.2f}",
        ]
        for seed, found in by_seed.items()
    ]
    rates = [rate(found["fresh"]["successes"], found["fresh"]["episodes"]) for found in by_seed.values()]
    mean = {
        "success_rate": fmean(each.success_rate for each in rates),
        "interval": interval_of_seeds(rates).model_dump(),
    }
    public = fmean(found["public"]["success_rate"] for found in by_seed.values())
    rows = [*lines, ["mean", percent(mean), "", f"{100 * public:.1f}", "", ""]]
    return "".join(f"| {' | '.join([task, name, *cells])} |\n" for cells in rows)


def percent(found: Mapping[str, Any]) -> str:
    """Return a rate with its interval."""
    low, high = 100 * found["interval"]["low"], 100 * found["interval"]["high"]
    return f"{100 * found['success_rate']:.1f} [{low:.1f}, {high:.1f}]"


if __name__ == "__main__":
    main()
