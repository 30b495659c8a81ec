import json
from datetime import UTC, datetime, timedelta, timezone
from uuid import UUID

import pytest
from vitac.cli.terminal import output


def test_columns_are_as_wide_as_their_widest_cell_and_numbers_go_right(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_table(["team", "steps"], [["Bears", 4.5], ["日本", None]], none="none")
    assert capsys.readouterr().out.splitlines() == ["team   steps", "Bears   4.50", "日本       -"]


def test_no_rows_are_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_table(["team"], [], none="No team yet.")
    assert capsys.readouterr().out == "No team yet.\n"


def test_json_writes_times_and_ids_as_text(capsys: pytest.CaptureFixture[str]) -> None:
    made = datetime(2026, 11, 21, tzinfo=UTC)
    output.print_json({"at": made, "id": UUID(int=1), "name": "日本"})
    printed = capsys.readouterr().out
    assert json.loads(printed) == {"at": "2026-11-21T00:00:00Z", "id": str(UUID(int=1)), "name": "日本"}
    assert "日本" in printed


def test_times_are_utc() -> None:
    assert output.moment(datetime(2026, 11, 21, 1, 0, tzinfo=timezone(timedelta(hours=1)))) == "2026-11-21 00:00:00Z"
    assert output.moment(None) is None
