from collections.abc import Callable
from pathlib import Path

import pytest
import typer
from vitac.cli.terminal.output import existing, existing_file


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
