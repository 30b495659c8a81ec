"""The learning curve of the challenge's own method: what its table says of a log."""

import csv
import sys
from pathlib import Path

import pytest
from policies.learning_curve import (
    ELAPSED,
    EVALUATED,
    HEAD,
    REWARD,
    STEPS,
    SUCCESS,
    line,
    main,
    percent,
    projection,
    table,
)

EMPTY = dict.fromkeys((STEPS, ELAPSED, REWARD, SUCCESS, EVALUATED), "")


def row(steps: int, elapsed_s: int, success: float = 0.25) -> dict[str, str]:
    return EMPTY | {STEPS: str(steps), ELAPSED: str(elapsed_s), REWARD: "-12.345", SUCCESS: str(success)}


def evaluation(steps: int, success: float) -> dict[str, str]:
    return EMPTY | {STEPS: str(steps), EVALUATED: str(success)}


def test_lines_tell_rewards_and_evaluations() -> None:
    assert line(row(1500, 90)) == "| 1500 | 1.5 | -12.35 | 25 |  |\n"
    assert line(evaluation(2000, 0.08)) == "| 2000 |  |  |  | 8 |\n"
    assert (percent(""), percent(None), percent("1.0")) == ("", "", "100")


def test_time_left_is_that_of_the_speed_since_the_gradients_began() -> None:
    timed = [row(500, 10), row(1000, 20), row(2000, 920)]
    assert projection(timed, "peg-insertion") == (
        "2,000 of 400,000 env steps were done in 15 minutes. "
        "At 0.90 s an env step since the gradients began, the rest would take 100 hours."
    )
    for early in (timed[:1], timed[:2]):
        assert "no gradient step yet" in projection(early, "peg-insertion")


def test_long_logs_are_thinned_but_keep_evaluations_and_the_end() -> None:
    rows = [row(40 * number, 30 * number) for number in range(1, 101)]
    rows.insert(50, evaluation(2000, 0.02))
    text = table(rows, "peg-insertion", "On an idle machine.")
    assert text.startswith(HEAD.format(task="peg-insertion", note="On an idle machine."))
    lines = [each for each in text.splitlines() if each.startswith("| ") and each[2].isdigit()]
    assert 20 <= len(lines) <= 24
    assert "| 2000 |  |  |  | 2 |" in lines
    assert lines[-1].startswith("| 4000 | 50.0 |")


@pytest.mark.parametrize("rows", [[], [evaluation(0, 0.0)]], ids=["empty", "evaluated only"])
def test_a_log_in_which_nothing_is_timed_yet_is_refused_by_name(
    rows: list[dict[str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "curve.md"
    monkeypatch.setattr(sys, "argv", ["learning_curve.py", str(tmp_path), "--out", str(out)])
    (tmp_path / "progress.csv").write_text(f"{STEPS},{EVALUATED}\n" + "".join("0,0.0\n" for _ in rows))
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2
    assert f"{tmp_path} has no finished episodes yet" in capsys.readouterr().err
    assert not out.exists()
    with (tmp_path / "progress.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(EMPTY))
        writer.writeheader()
        writer.writerows([*rows, row(500, 10)])
    main()
    assert "| 500 | 0.2 | -12.35 | 25 |  |" in out.read_text()


def test_table_in_the_repository_is_of_the_published_training(repository: Path) -> None:
    text = (repository / "benchmarks" / "td3_curve.md").read_text()
    assert text.startswith(HEAD.partition("{task}")[0])
    assert " of 400,000 env steps were done in " in text
