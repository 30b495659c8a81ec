"""The log of a run or a search: what is written is read, it only grows, and damage is found."""

from pathlib import Path

import pytest
from vitac.training.files import FileDamaged
from vitac.training.log import Row, extend_log, read_log

ROWS = [{"number": 1, "solved": 0.1}, {"number": 2, "solved": 1 / 3}]


def number(row: Row) -> int:
    return int(row["number"])


def test_what_was_written_is_read_to_the_last_bit(tmp_path: Path) -> None:
    log = tmp_path / "run" / "log.jsonl"
    assert read_log(log, number) == []
    extend_log(log, ROWS)
    assert read_log(log, dict) == ROWS
    assert log.read_text().count("\n") == 2


def test_log_grows_and_never_gets_shorter(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    for rows, expected in ((ROWS[:1], [1]), (ROWS, [1, 2]), (ROWS[:1], [1, 2]), ([], [1, 2]), (ROWS[::-1], [1, 2])):
        extend_log(log, rows)
        assert read_log(log, number) == expected


@pytest.mark.parametrize(
    "text", ["{", "[]\n", "3\n", '{"solved": 1}\n', '{"number": "one"}\n', '{"number": null}', "\xff"]
)
def test_damage_is_found(tmp_path: Path, text: str) -> None:
    log = tmp_path / "log.jsonl"
    log.write_bytes(text.encode("latin-1"))
    with pytest.raises(FileDamaged, match=r"log.jsonl does not hold what was written; delete it and run it again"):
        read_log(log, number)
