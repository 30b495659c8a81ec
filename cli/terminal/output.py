"""Prints the results of commands: aligned columns for people, JSON for programs. Called by the commands."""

import json
import sys
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Annotated, Any, cast

import typer
from rich.cells import cell_len

GAP = "  "
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
"""The option of every command that reads or changes something."""


def print_json(content: object) -> None:
    """Print JSON, with times and ids as text."""
    print(json.dumps(content, indent=2, ensure_ascii=False, default=_as_text))


def warn(sentence: str) -> None:
    """Print what is easily overlooked on standard error."""
    print(f"WARNING: {sentence}", file=sys.stderr)


def print_table(columns: Sequence[str], rows: Sequence[Sequence[object]], *, none: str) -> None:
    """Print rows under their headings, each column as wide as its widest cell, numbers right-aligned.

    Args:
        columns: headings.
        rows: cells; None is shown as a dash.
        none: printed if there are no rows.
    """
    if not rows:
        print(none)
        return
    texts = [[_cell(value) for value in row] for row in rows]
    widths = [max(cell_len(text) for text in column) for column in zip(columns, *texts, strict=True)]
    numeric = [all(isinstance(row[index], int | float | None) for row in rows) for index in range(len(columns))]
    for line in (list(columns), *texts):
        print(GAP.join(_align(*cell) for cell in zip(line, widths, numeric, strict=True)).rstrip())


def print_pairs(pairs: Mapping[str, object]) -> None:
    """Print one name and value a line."""
    width = max(len(name) for name in pairs)
    for name, value in pairs.items():
        print(f"{name:<{width}}{GAP}{_cell(value)}")


def print_record(record: Mapping[str, object], *, as_json: bool) -> None:
    """Print one record: as JSON, or one field a line."""
    if as_json:
        print_json(record)
    else:
        print_pairs(record)


def print_records(records: Sequence[Mapping[str, object]], columns: Sequence[str], *, none: str, as_json: bool) -> None:
    """Print records: as JSON, or some of their fields in a table.

    Args:
        records: the records.
        columns: fields of the table.
        none: printed if there are no records.
        as_json: print all fields as JSON.
    """
    if as_json:
        print_json(records)
    else:
        print_table(columns, [[record[name] for name in columns] for record in records], none=none)


def moment(when: datetime | None) -> str | None:
    """Format a time in UTC to the second."""
    from datetime import UTC

    return None if when is None else when.astimezone(UTC).strftime("%Y-%m-%d %H:%M:%SZ")


def percent(fraction: float | None) -> str | None:
    """Format a fraction as a percentage with one decimal."""
    return None if fraction is None else f"{100 * fraction:.1f} %"


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.2f}"
    if hasattr(value, "astimezone"):
        return str(moment(cast("datetime", value)))
    return "-" if value is None or value == "" else str(value)


def _align(text: str, width: int, right_aligned: bool) -> str:
    space = " " * (width - cell_len(text))
    return space + text if right_aligned else text + space


def _as_text(value: Any) -> str:
    """Write times as the REST API does."""
    return value.isoformat().replace("+00:00", "Z") if hasattr(value, "isoformat") else str(value)
