"""Writes the learning curve of the challenge's own method as a table, and how much CPU time the whole training takes.

PYTHONPATH=benchmarks python benchmarks/policies/learning_curve.py RUN [--note TEXT]
                                                             [--out benchmarks/td3_curve.md]

RUN is the folder of `vitac train reference`, also of a training that still runs or was stopped.
"""

import argparse
import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

Row = Mapping[str, str]
Recipe = Mapping[str, Any]

LINES = 20
"""Approximate number of lines of the curve."""
STEPS, CPU_S = "time/total_timesteps", "time/cpu_s"
REWARD, SUCCESS, EVALUATED = "rollout/ep_rew_mean", "rollout/success_rate", "eval/success_rate"
HEAD = """# Learning curve of the challenge's own method

Written by `PYTHONPATH=benchmarks python benchmarks/policies/learning_curve.py RUN` of a training by
`vitac train reference {task}` at the published hyperparameters. Every 2,000 env steps 50 held-out starts
were played without noise; the last column is of all such evaluations since the line above. {note}

| env steps | CPU minutes | mean reward of 100 noisy episodes | solved of these, % | solved of held-out starts |
|---|---|---|---|---|
"""


def main() -> None:
    """Read the log and write the table."""
    parser = argparse.ArgumentParser(description="learning curve of the challenge's own method")
    parser.add_argument("run", type=Path, help="folder of the training")
    parser.add_argument("--note", default="", help="what else is to be said, such as how busy the machine was")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "td3_curve.md")
    chosen = parser.parse_args()
    with (chosen.run / "progress.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    if not select_episode_rows(rows):
        parser.error(f"{chosen.run} has no finished episodes yet; try again after some minutes.")
    recipe = json.loads((chosen.run / "run.json").read_text())["recipe"]
    chosen.out.write_text(table(rows, recipe, chosen.note))


def table(rows: Sequence[Row], recipe: Recipe, note: str) -> str:
    """Return the curve by the rows of a log, one of them of episodes at least, and the time that the rest takes."""
    timed = select_episode_rows(rows)
    kept = timed[:: max(1, len(timed) // LINES)]
    if kept[-1] is not timed[-1]:
        kept.append(timed[-1])
    evaluated = [(int(row[STEPS]), float(row[EVALUATED])) for row in rows if row.get(EVALUATED)]
    played = recipe["evaluation_episodes"]
    text, before = HEAD.format(task=recipe["task"], note=note).replace(" \n", "\n"), 0
    for row in kept:
        done = int(row[STEPS])
        text += line(row, [round(rate * played) for steps, rate in evaluated if before < steps <= done], played)
        before = done
    return f"{text}\n{projection(timed, recipe)}\n"


def select_episode_rows(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of the training's own episodes; those of evaluations have a time, too, that of before them."""
    return [row for row in rows if row.get(CPU_S) and row.get(REWARD)]


def line(row: Row, solved: Sequence[int], played: int) -> str:
    """Return the line of a row, with the evaluations since the line before: successes of each, and its episodes."""
    minutes = f"{float(row[CPU_S]) / 60:.1f}"
    reward = f"{float(row[REWARD]):.2f}"
    held_out = f"{sum(solved)} of {played * len(solved)}" if solved else ""
    return f"| {' | '.join([row[STEPS], minutes, reward, percent(row.get(SUCCESS)), held_out])} |\n"


def percent(rate: str | None) -> str:
    """Return a rate in %, nothing where there is none."""
    return f"{100 * float(rate):.0f}" if rate else ""


def projection(timed: Sequence[Row], recipe: Recipe) -> str:
    """Return how far the training got, and what the rest takes by what each env step took since the gradients began."""
    learning = [row for row in timed if int(row[STEPS]) >= recipe["learning_starts"]]
    done, cpu_s = int(timed[-1][STEPS]), float(timed[-1][CPU_S])
    found = f"{done:,} of {recipe['env_steps']:,} env steps took {cpu_s / 60:.0f} minutes of CPU time."
    steps = done - int(learning[0][STEPS]) if learning else 0
    if not steps:
        return f"{found} There was no gradient step yet that tells what the rest takes."
    step_s = (cpu_s - float(learning[0][CPU_S])) / steps
    left_h = step_s * (recipe["env_steps"] - done) / 3600
    return (
        f"{found} At {step_s:.3f} s an env step since the gradients began, evaluations included, the rest takes "
        f"{left_h:.1f} hours of one core."
    )


if __name__ == "__main__":
    main()
