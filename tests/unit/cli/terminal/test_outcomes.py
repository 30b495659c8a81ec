import pytest
from vitac.cli.terminal.output import print_meanings


def test_each_word_is_explained_once_in_the_order_of_its_first_use(capsys: pytest.CaptureFixture[str]) -> None:
    print_meanings(["tactile", "success", "tactile"])
    assert capsys.readouterr().out.splitlines() == [
        "tactile: The gel surface of a sensor moved too far.",
        "success: The task was solved.",
    ]
