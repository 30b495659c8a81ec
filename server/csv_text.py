"""Tables as CSV for spreadsheets. Called by exports, pages and commands."""

import csv
import io
from collections.abc import Iterable, Sequence

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
"""How a text begins that a spreadsheet would run."""


def csv_text(rows: Iterable[Sequence[object]]) -> str:
    """Return rows as CSV; texts that a spreadsheet would run as a formula get an apostrophe in front."""
    text = io.StringIO()
    csv.writer(text).writerows([_safe(cell) for cell in row] for row in rows)
    return text.getvalue()


def _safe(cell: object) -> object:
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(FORMULA_STARTS) and not _is_numbers(cell) else cell


def _is_numbers(text: str) -> bool:
    return all(part.lstrip("-").replace(".", "", 1).isdecimal() for part in text.split(" "))
