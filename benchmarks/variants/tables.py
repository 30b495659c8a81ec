"""Writes the tables of docs/variants.md and of the README beside this file from the figures there.

python benchmarks/variants/tables.py

`sweep_TASK.json` is what `one_at_a_time.py --json` wrote, `headroom_TASK_N.json` what `headroom.py --json` wrote for
list N.
"""

import json
import re
from pathlib import Path
from typing import Any

from vitac.envs.tasks.quantities import Quantity
from vitac.evaluator.tracks import Task
from vitac.evaluator.tracks.registry import find_task

FOLDER = Path(__file__).parent
DOCUMENT = FOLDER.parents[1] / "docs" / "variants.md"
README = FOLDER / "README.md"
SWEPT = ("peg-insertion-robust", "lock-opening-robust", "fusion-robust")


def main() -> None:
    """Put every table in the place of the one that stands there."""
    fill(DOCUMENT, {"headroom": headroom()})
    fill(README, {task: quantities(task) for task in SWEPT})


def fill(document: Path, tables: dict[str, str]) -> None:
    """Put each table where the document has its name."""
    text = document.read_text()
    for name, table in tables.items():
        found = re.search(rf"<!-- table {name} -->\n(.*?)<!-- end -->", text, re.DOTALL)
        assert found, name  # noqa: S101 - the page has a place for each
        text = text[: found.start(1)] + table + text[found.end(1) :]
    document.write_text(text)


def headroom() -> str:
    """Return the table of both players' rates in each task."""
    lines = ["| task | list | example | planner with the truth | quantities, monotone |", "|---|---|---|---|---|"]
    for name in sorted({path.stem.split("_")[1] for path in FOLDER.glob("headroom_*_*.json")}):
        for number, found in enumerate(read_lists(name), start=1):
            example, truth = (written(found["players"][player]) for player in ("example", "truth"))
            drawn = found["by_draw"].values()
            monotone = f"{len(drawn)}, {sum(quantity['monotone'] for quantity in drawn)}"
            lines.append(f"| `{name}` | {number} | {example} | {truth} | {monotone} |")
    return "\n".join(lines) + "\n"


def quantities(name: str) -> str:
    """Return a row for each quantity: its range, what its ends alone take from the example, and its success there."""
    _, task = find_task(name)
    rows, found = json.loads((FOLDER / f"sweep_{name}.json").read_text()), read_lists(name)[-1]
    nominal = next(row for row in rows if not row["fixed"])
    lines = [
        "| quantity | range | alone, % | with all, % along the range |",
        "|---|---|---|---|",
    ]
    lines.append(f"| none | | {written(nominal['example'])} | |")
    lines += [_row(task, quantity, rows, found) for quantity in task.drawn_quantities]
    return "\n".join(lines) + "\n"


def _row(task: Task, quantity: Quantity, rows: list[dict[str, Any]], found: dict[str, Any]) -> str:
    low, high = task.draws[quantity.name]
    unit = "" if quantity.unit == "1" else f" {quantity.unit}"
    alone = [
        f"{value:g}: {100 * row['example']['success_rate']:.0f}"
        for row in rows
        for name, value in row["fixed"].items()
        if name == quantity.name
    ]
    parts = found["by_draw"][quantity.name]["parts"]
    along = ", ".join(f"{100 * part['rate']['success_rate']:.0f}" for part in parts)
    return f"| `{quantity.name}` | {low:g} to {high:g}{unit} | {'; '.join(alone)} | {along} |"


def written(rate: dict[str, Any]) -> str:
    """Return a rate as "34 % [26, 43] of 150"."""
    low, high = (100 * rate["interval"][end] for end in ("low", "high"))
    return f"{100 * rate['success_rate']:.0f} % [{low:.0f}, {high:.0f}] of {rate['episodes']}"


def read_lists(task: str) -> list[dict[str, Any]]:
    """Return the figures of a task's lists, each made from a secret of its own."""
    return [json.loads(path.read_text()) for path in sorted(FOLDER.glob(f"headroom_{task}_*.json"))]


if __name__ == "__main__":
    main()
