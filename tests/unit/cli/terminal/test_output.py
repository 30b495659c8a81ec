import json
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from uuid import UUID

import pytest
import typer
from vitac.cli.terminal import output
from vitac.cli.terminal.output import existing, existing_file, note_ignored_folders, print_meanings


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


def test_pairs_are_one_a_line_with_their_values_below_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_pairs({"team": "Bears", "success": None, "steps": 4.5, "note": "", "done": 0, "good": False})
    assert capsys.readouterr().out.splitlines() == [
        "team     Bears",
        "success  -",
        "steps    4.50",
        "note     -",
        "done     0",
        "good     False",
    ]


def test_times_are_written_to_the_second_wherever_they_stand(capsys: pytest.CaptureFixture[str]) -> None:
    made = datetime(2026, 11, 21, 5, 6, 7, 999_000, tzinfo=UTC)
    output.print_pairs({"made": made})
    output.print_table(["made"], [[made]], none="")
    assert capsys.readouterr().out.split("\n")[::2] == ["made  2026-11-21 05:06:07Z", "2026-11-21 05:06:07Z"]


RECORD = {"name": "Bears", "rank": 1, "id": UUID(int=1)}


def test_a_record_is_pairs_or_json(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_record(RECORD, as_json=False)
    assert capsys.readouterr().out.splitlines()[:2] == ["name  Bears", "rank  1"]
    output.print_record(RECORD, as_json=True)
    assert json.loads(capsys.readouterr().out) == {**RECORD, "id": str(UUID(int=1))}


def test_records_are_some_columns_of_a_table_or_all_of_them_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_records([RECORD, {**RECORD, "rank": 10}], ["rank", "name"], none="", as_json=False)
    assert capsys.readouterr().out.splitlines() == ["rank  name", "   1  Bears", "  10  Bears"]
    output.print_records([RECORD], ["rank"], none="", as_json=True)
    assert [set(row) for row in json.loads(capsys.readouterr().out)] == [set(RECORD)]


@pytest.mark.parametrize(("as_json", "printed"), [(False, "No team yet.\n"), (True, "[]\n")])
def test_no_records_are_a_sentence_or_an_empty_list(
    as_json: bool, printed: str, capsys: pytest.CaptureFixture[str]
) -> None:
    output.print_records([], ["rank"], none="No team yet.", as_json=as_json)
    assert capsys.readouterr().out == printed


def test_a_column_of_numbers_and_gaps_goes_right_and_one_with_a_word_left(capsys: pytest.CaptureFixture[str]) -> None:
    output.print_table(["steps", "mixed"], [[None, 1], [12, "many"]], none="")
    assert capsys.readouterr().out.splitlines() == ["steps  mixed", "    -  1", "   12  many"]


@pytest.mark.parametrize(
    ("fraction", "text"), [(None, None), (0.0, "0.0 %"), (1.0, "100.0 %"), (0.12345, "12.3 %"), (0.9996, "100.0 %")]
)
def test_fractions_are_percentages_with_one_decimal(fraction: float | None, text: str | None) -> None:
    assert output.percent(fraction) == text


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("run.jsonl", "other.jsonl"):
        (tmp_path / name).touch()
    return tmp_path


@pytest.mark.parametrize("check", [existing, existing_file])
def test_wrong_file_name_lists_the_files_that_are_there(folder: Path, check: Callable[[Path], object]) -> None:
    with pytest.raises(typer.BadParameter) as caught:
        check(folder / "rnu.jsonl")
    assert f"rnu.jsonl does not exist; folder {folder} holds 'other.jsonl', 'run.jsonl'." in str(caught.value)


def test_folder_in_place_of_a_file_lists_its_files(folder: Path) -> None:
    with pytest.raises(typer.BadParameter, match=r"expected a file; folder .* holds 'other\.jsonl', 'run\.jsonl'\."):
        existing_file(folder)


def test_what_is_there_is_accepted(folder: Path) -> None:
    assert existing(folder) == folder
    assert existing_file(folder / "run.jsonl") == folder / "run.jsonl"
    assert existing_file(None) is None


def test_the_folder_of_another_track_beside_the_submission_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for top in ("Track_1", "Track_2"):
        note_ignored_folders(tmp_path)
        assert capsys.readouterr().err == ""
        (tmp_path / top).mkdir()
        (tmp_path / top / "submission.yaml").touch()
    note_ignored_folders(tmp_path)
    taken = tmp_path / "Track_1"
    assert capsys.readouterr().err == (
        f"vitac: takes {taken}; Track_2 beside it is ignored: name that folder to take it\n"
    )
    note_ignored_folders(taken)
    assert capsys.readouterr().err == ""


def test_each_word_is_explained_once_in_the_order_of_its_first_use(capsys: pytest.CaptureFixture[str]) -> None:
    print_meanings(["tactile", "success", "tactile"])
    assert capsys.readouterr().out.splitlines() == [
        "tactile: The gel surface of a sensor moved too far.",
        "success: The task was solved.",
    ]
