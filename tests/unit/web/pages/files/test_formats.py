import csv
import io
import json
from datetime import UTC, datetime

import pytest
from vitac.server.csv_text import csv_text
from vitac.web.pages.files.formats import TableFormat, objects, table_file


@pytest.mark.parametrize("text", ["=1+1", "+1+1", "-1+cmd", "@SUM(A1)", "\tx", "\rx", "-", "+", "-1 =x"])
def test_a_text_that_a_spreadsheet_would_run_gets_an_apostrophe(text: str) -> None:
    assert next(csv.reader(io.StringIO(csv_text([(text,)]), newline=""))) == [f"'{text}"]


@pytest.mark.parametrize("cell", ["-4 2 0.5", "-1", -4.5, "plain", "a=b", 3])
def test_numbers_and_plain_texts_stay(cell: object) -> None:
    assert next(csv.reader(io.StringIO(csv_text([(cell,)])))) == [str(cell)]


def test_what_is_missing_is_an_empty_cell_and_null() -> None:
    columns, rows = ("a", "b"), [(None, 'x, "y"\nz')]
    as_csv, as_json = (table_file(form, "name", columns, rows) for form in (TableFormat.CSV, TableFormat.JSON))
    assert list(csv.DictReader(io.StringIO(bytes(as_csv.body).decode(), newline=""))) == [{"a": "", "b": 'x, "y"\nz'}]
    assert json.loads(bytes(as_json.body)) == [{"a": None, "b": 'x, "y"\nz'}]
    for answer, form in ((as_csv, "csv"), (as_json, "json")):
        assert answer.headers["content-disposition"] == f'attachment; filename="name.{form}"'
        assert answer.headers["cache-control"] == "no-store"


def test_a_row_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="zip"):
        objects(("a", "b"), [(datetime.now(UTC),)])
