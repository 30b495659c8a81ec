"""Tables as files: CSV with a row of names first, JSON with an object for each row. Called by the modules beside it."""

from collections.abc import Iterable, Sequence
from enum import StrEnum

from starlette.responses import JSONResponse, Response
from vitac.server.csv_text import csv_text


class TableFormat(StrEnum):
    """How a table is written; the end of the file's name."""

    CSV = "csv"
    """For spreadsheets."""
    JSON = "json"
    """For programs."""


def table_file(form: TableFormat, name: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Response:
    """Return a table in one of the formats."""
    if form is TableFormat.CSV:
        return csv_file(name, columns, rows)
    return json_file(name, objects(columns, rows))


def csv_file(name: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Response:
    """Return a table as a file."""
    return attached(Response(csv_text([columns, *rows]), media_type="text/csv"), f"{name}.csv")


def json_file(name: str, content: object) -> Response:
    """Return an object or a list as a file."""
    return attached(JSONResponse(content), f"{name}.json")


def objects(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> list[dict[str, object]]:
    """Return an object for each row."""
    return [dict(zip(columns, row, strict=True)) for row in rows]


def attached(answer: Response, name: str) -> Response:
    """Return an answer that browsers store under a name; nobody keeps a copy on the way."""
    answer.headers["Content-Disposition"] = f'attachment; filename="{name}"'
    answer.headers["Cache-Control"] = "no-store"
    return answer
