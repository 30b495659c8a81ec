"""Writes the learning curve of the challenge's own method as a table, and when the training would end.

PYTHONPATH=benchmarks python benchmarks/policies/learning_curve.py RUN [--task peg-insertion] [--note TEXT]
                                                             [--out benchmarks/td3_curve.md]

RUN is the folder of `vitac train reference`, also while it goes on.
"""

import argparse
import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from vitac.training.reference.hyperparameters import HYPERPARAMETERS

Row = Mapping[str, str]

LINES = 20
"""About so many lines have the curve."""
STEPS, ELAPSED = "time/total_timesteps", "time/time_elapsed"
REWARD, SUCCESS, EVALUATED = "rollout/ep_rew_mean", "rollout/success_rate", "eval/success_rate"
HEAD = """# Learning curve of the challenge's own method

Written by `PYTHONPATH=benchmarks python benchmarks/policies/learning_curve.py RUN` of a training by
`vitac train reference {task}` at the published hyperparameters. {note}

| env steps | minutes | mean reward of 100 episodes, with noise | solved of these, % | solved of 50 held-out starts, % |
|---|---|---|---|---|
"""


def main() -> None:
    """Read the log and write the table."""
    parser = argparse.ArgumentParser(description="learning curve of the challenge's own method")
    parser.add_argument("run", type=Path, help="folder of the training")
    parser.add_argument("--task", default="peg-insertion", choices=sorted(HYPERPARAMETERS))
    parser.add_argument("--note", default="", help="what else is to be said, such as how busy the machine was")
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "td3_curve.md")
    chosen = parser.parse_args()
    with (chosen.run / "progress.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    if not any(row.get(ELAPSED) for row in rows):
        parser.error(f"{chosen.run} has no finished episodes yet; try again when it has gone on for some minutes.")
    chosen.out.write_text(table(rows, chosen.task, chosen.note))


def table(rows: Sequence[Row], task: str, note: str) -> str:
    """Return the curve by the rows of a log, one of them timed at least, and the time that the rest would take."""
    timed = [row for row in rows if row[ELAPSED]]
    kept = timed[:: max(1, len(timed) // LINES)]
    shown = [row for row in rows if row in kept or row.get(EVALUATED) or row is timed[-1]]
    text = HEAD.format(task=task, note=note).replace(" \n", "\n") + "".join(line(row) for row in shown)
    return f"{text}\n{projection(timed, task)}\n"


def line(row: Row) -> str:
    """Return the line of a row; an evaluation has no time of its own."""
    minutes = f"{float(row[ELAPSED]) / 60:.1f}" if row[ELAPSED] else ""
    reward = f"{float(row[REWARD]):.2f}" if row[REWARD] else ""
    cells = [row[STEPS], minutes, reward, *(percent(row.get(key)) for key in (SUCCESS, EVALUATED))]
    return f"| {' | '.join(cells)} |\n"


def percent(rate: str | None) -> str:
    """Return a rate in %, nothing where there is none."""
    return f"{100 * float(rate):.0f}" if rate else ""


def projection(timed: Sequence[Row], task: str) -> str:
    """Return how far the training got, and when it would end at the speed of the time after the first gradient step."""
    chosen = HYPERPARAMETERS[task]
    learning = [row for row in timed if int(row[STEPS]) >= chosen.learning_starts]
    done, elapsed_s = int(timed[-1][STEPS]), float(timed[-1][ELAPSED])
    found = f"{done:,} of {chosen.env_steps:,} env steps were done in {elapsed_s / 60:.0f} minutes."
    steps = done - int(learning[0][STEPS]) if learning else 0
    if not steps:
        return f"{found} There was no gradient step yet that tells when the rest would be done."
    step_s = (elapsed_s - float(learning[0][ELAPSED])) / steps
    left_h = step_s * (chosen.env_steps - done) / 3600
    return f"{found} At {step_s:.2f} s an env step since the gradients began, the rest would take {left_h:.0f} hours."


if __name__ == "__main__":
    main()
