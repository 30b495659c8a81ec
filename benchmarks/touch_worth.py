"""What touch is worth in a task: policies without it, with it and with the truth, on the same fresh starts.

Usage: python benchmarks/touch_worth.py TASK EXAMPLE [--clone RUN] [--starts N] [--to FOLDER]

On the same starts play: no motion, random actions, the submission in the folder EXAMPLE, the same with the markers as
they were at the start, and the planner that knows the truth (its first plan). RUN is the folder of a finished
`vitac train clone`, which holds what its policy and a blind one solved of the starts that it reports; they are then the
starts for all. Measures of tasks already in the folder stay; page and picture show all of them.
"""

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from runpy import run_path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from vitac.evaluator.episodes.episode import make_environment
from vitac.evaluator.scoring.score import rate
from vitac.evaluator.tracks import Task, find_task
from vitac.training.demonstrations.expert import PLANS, Expert
from vitac.training.streams import Use, stream

FOLDER = Path(__file__).parent / "touch_worth"
SEED = 3
Act = Callable[[Mapping[str, Any]], NDArray[np.float32]]
PLAYERS = {
    "rest": "no motion",
    "random": "random actions",
    "blind": "clone without touch",
    "hidden": "example, touch hidden",
    "example": "example, by touch",
    "clone": "clone, by touch",
    "truth": "planner with the truth",
}


def main() -> None:
    """Play, and write numbers, page and picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", help="name of a task that has an expert, such as slip")
    parser.add_argument("example", type=Path, help="folder of a submission that plays the task by touch")
    parser.add_argument("--clone", type=Path, help="folder of a finished `vitac train clone`")
    parser.add_argument("--starts", type=int, default=60, help="how many, where there is no clone")
    parser.add_argument("--to", type=Path, default=FOLDER, help="folder of the results")
    options = parser.parse_args()
    _, task = find_task(options.task)
    seed, number_of_starts, solved = SEED, options.starts, {}
    if options.clone is not None:
        seed = json.loads((options.clone / "run.json").read_text())["recipe"]["seed"]
        gain = json.loads((options.clone / "gain.json").read_text())
        number_of_starts = gain["episodes"]
        solved = {"blind": gain["blind_successes"], "clone": gain["standard_successes"]}
    starts = [{"rng_seed": (stream(seed, Use.REPORT), number)} for number in range(number_of_starts)]
    solved |= {name: play(task, starts, begin) for name, begin in players(task, options.example).items()}
    expert = Expert(task)
    solved["truth"] = sum(bool(expert.play(start, PLANS[:1]).info["is_success"]) for start in starts)
    path = options.to / "touch_worth.json"
    stored = json.loads(path.read_text()) if path.exists() else {}
    stored[task.name] = {"episodes": len(starts), "solved": {name: solved[name] for name in PLAYERS if name in solved}}
    options.to.mkdir(exist_ok=True)
    path.write_text(json.dumps(stored, indent=1) + "\n")
    (options.to / "README.md").write_text(page(stored))
    metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))  # no dates, and no addresses
    with mpl.rc_context({"svg.hashsalt": "touch_worth", "svg.fonttype": "none"}):
        picture(stored).savefig(options.to / "touch_worth.svg", metadata=metadata)


def players(task: Task, example: Path) -> dict[str, Callable[[int], Act]]:
    """Return by name what begins the policy of an episode of that number."""
    size = len(task.actions)
    [file] = example.rglob("policy.py")
    policy = run_path(str(file))["Policy"]()

    def draw(number: int) -> Act:
        random = np.random.default_rng([SEED, number])
        return lambda _: random.uniform(-1, 1, size).astype(np.float32)

    def begin(_: int) -> Act:
        policy.reset(task)
        act: Act = policy.act
        return act

    def begin_without_touch(number: int) -> Act:
        act = begin(number)
        felt: dict[str, Any] = {}

        def act_without_touch(observation: Mapping[str, Any]) -> NDArray[np.float32]:
            felt.setdefault("marker_flow", observation["marker_flow"])
            return act({**observation, **felt})

        return act_without_touch

    return {
        "rest": lambda _: lambda _: np.zeros(size, dtype=np.float32),
        "random": draw,
        "hidden": begin_without_touch,
        "example": begin,
    }


def play(task: Task, starts: list[dict[str, Any]], begin: Callable[[int], Act]) -> int:
    """Return how many starts a policy solves."""
    env: Any = make_environment(task)
    solved = 0
    for number, start in enumerate(starts):
        observation, info = env.reset(options=start)
        act = begin(number)
        while info["end_reason"] is None:
            observation, *_, info = env.step(act(observation))
        solved += bool(info["is_success"])
    return solved


def page(stored: Mapping[str, Any]) -> str:
    """Return the table of all tasks as Markdown."""
    names = "".join(f" {words} |" for words in PLAYERS.values())
    lines = [
        "# What touch is worth\nWritten by `benchmarks/touch_worth.py`: successes from the same fresh starts, in % "
        "with 95 % interval.\n\n![Solved by whom](touch_worth.svg)\n",
        f"| task | starts |{names}",
        "|---" * (2 + len(PLAYERS)) + "|",
    ]
    for task, row in stored.items():
        cells = [_percent(row, name) for name in PLAYERS]
        lines.append(f"| {task} | {row['episodes']} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _percent(row: Mapping[str, Any], name: str) -> str:
    if name not in row["solved"]:
        return "–"
    found = rate(row["solved"][name], row["episodes"])
    low, high = found.interval.low, found.interval.high
    return f"{100 * found.success_rate:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def picture(stored: Mapping[str, Any]) -> Figure:
    """Return a panel for each task: who solves how much, with the interval."""
    figure = Figure(figsize=(7.0, 0.5 + 1.7 * len(stored)), layout="constrained")
    panels = figure.subplots(len(stored), squeeze=False, sharex=True)[:, 0]
    for axes, (task, row) in zip(panels, stored.items(), strict=True):
        for height, name in enumerate(name for name in PLAYERS if name in row["solved"]):
            found = rate(row["solved"][name], row["episodes"])
            ends = (100 * found.interval.low, 100 * found.interval.high)
            axes.plot(ends, (height, height), color="#9ec5e8", linewidth=6, solid_capstyle="butt")
            axes.plot(100 * found.success_rate, height, "o", color="#1f4e79")
        axes.set_yticks(range(len(row["solved"])), [PLAYERS[name] for name in PLAYERS if name in row["solved"]])
        axes.set_title(task, loc="left", size=10)
        axes.set_xlim(-2, 102)
        axes.grid(axis="x", color="#dddddd")
        axes.spines[["top", "right"]].set_visible(False)
    panels[-1].set_xlabel("solved [%], and 95 % interval")
    return figure


if __name__ == "__main__":
    main()
