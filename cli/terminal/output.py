"""Prints the results of commands: aligned columns for people, JSON for programs. Called by the commands."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from rich.cells import cell_len

if TYPE_CHECKING:
    from vitac.evaluator.figures.figures import SensorFigures

GAP = "  "
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
"""The option of every command that reads or changes something."""
AsCsv = Annotated[bool, typer.Option("--csv", help="Print CSV, for a spreadsheet.")]
AsLatex = Annotated[bool, typer.Option("--latex", help="Print tables for LaTeX, with the package booktabs.")]


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


LATEX_SPECIAL = str.maketrans(
    {character: f"\\{character}" for character in "&%$#_{}"}
    | {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "\\": r"\textbackslash{}"}
)


def print_latex(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print rows as a `tabular` with the rules of the package `booktabs`, numbers right-aligned."""
    numeric = (all(isinstance(row[index], int | float | None) for row in rows) for index in range(len(columns)))
    lines = [" & ".join(_cell(value).translate(LATEX_SPECIAL) for value in row) + r" \\" for row in (columns, *rows)]
    print(rf"\begin{{tabular}}{{{''.join('r' if each else 'l' for each in numeric)}}}")
    print("\n".join([r"\toprule", lines[0], r"\midrule", *lines[1:], r"\bottomrule", r"\end{tabular}"]))


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


def existing(path: Path | None) -> Path | None:
    """Return the path of a file or folder; None if none was named.

    Raises:
        BadParameter: it does not exist.
    """
    if path is not None and not path.exists():
        from vitac.evaluator.submission.names import describe_contents

        raise typer.BadParameter(f"{path} does not exist; {describe_contents(path.parent)}.")
    return path


def existing_file(path: Path | None) -> Path | None:
    """Return the path of a file; None if none was named.

    Raises:
        BadParameter: it does not exist, or is a folder.
    """
    if path is not None and path.is_dir():
        from vitac.evaluator.submission.names import describe_contents

        raise typer.BadParameter(f"expected a file; {describe_contents(path)}.")
    return existing(path)


def note_ignored_folders(path: Path) -> None:
    """Print a note where a folder holds submissions for several tracks, of which the first is meant."""
    from vitac.envs.untrusted_file import find_spelling
    from vitac.evaluator.submission.names import MANIFEST_NAME
    from vitac.evaluator.tracks import archive_folders

    ignored = (
        []
        if find_spelling(path, MANIFEST_NAME).is_file()
        else [top for top in archive_folders() if find_spelling(path / top, MANIFEST_NAME).is_file()]
    )
    if len(ignored) > 1:
        print(
            f"vitac: takes {path / ignored[0]}; {' and '.join(ignored[1:])} beside it "
            f"{'is' if len(ignored) == 2 else 'are'} ignored: name that folder to take it",
            file=sys.stderr,
        )


Server = Annotated[str | None, typer.Option(help="Address of the service; default: VITAC_SERVER.")]
TokenFile = Annotated[Path | None, typer.Option(help="File with the API token; default: VITAC_TOKEN.")]
Episodes = Annotated[str | None, typer.Option(help="Numbers and ranges, such as 1:12,20; all by default.")]
Workers = Annotated[int | None, typer.Option(min=1, help="Number of processes; one per core by default.")]
Processes = Annotated[int, typer.Option(min=1, help="Processes that play episodes.")]
Ray = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Ray cluster that plays instead, such as 10.0.0.1:6379 or auto.")
]
ASSETS_VARIABLE = "VITAC_ASSETS_DIR"
"""Only commands read it: one that is left set cannot change a ranked evaluation."""
Assets = Annotated[Path | None, typer.Option(envvar=ASSETS_VARIABLE, help="Folder with the challenge's own meshes.")]


def print_meanings(outcomes: Iterable[str]) -> None:
    """Print a line for each of the words, in the order of their first use."""
    from vitac.evaluator.episodes.records import EpisodeOutcome

    for outcome in dict.fromkeys(outcomes):
        print(f"{outcome}: {EpisodeOutcome(outcome).sentence}")


def program_name() -> str:
    """Return `./vitac` inside a checkout with the launcher, else `vitac`."""
    launcher = Path(__file__).resolve().parents[2] / "vitac"
    beside = launcher.is_file() and os.access(launcher, os.X_OK) and Path.cwd() == launcher.parent
    return "./vitac" if beside else "vitac"


def print_figures(figures: SensorFigures) -> None:
    """Print all figures of a sensor, and their digest."""
    from vitac.evaluator.figures.table import make_rows, reference_figures

    rows = [
        (row.name, _text(row.value), _text(row.reference), row.unit) for row in make_rows(figures, reference_figures())
    ]
    print_table(("figure", "sensor", "reference gel", "unit"), rows, none="")
    print(f"{figures.starts} starts; digest of the figures {figures.digest}")


def _text(value: float | None) -> str | None:
    return None if value is None else f"{value:.4g}"
