"""The learning curve of the challenge's own method: what its table says of a log."""

import csv
import json
import sys
from pathlib import Path

import pytest
from policies.learning_curve import (
    CPU_S,
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

RECIPE = {"task": "peg-insertion", "env_steps": 400_000, "learning_starts": 1000, "evaluation_episodes": 50}
EMPTY = dict.fromkeys((STEPS, CPU_S, REWARD, SUCCESS, EVALUATED), "")


def row(steps: int, cpu_s: int, success: float = 0.25) -> dict[str, str]:
    return EMPTY | {STEPS: str(steps), CPU_S: str(cpu_s), REWARD: "-12.345", SUCCESS: str(success)}


def evaluation(steps: int, success: float) -> dict[str, str]:
    return EMPTY | {STEPS: str(steps), CPU_S: "1510.0", EVALUATED: str(success)}


def test_lines_tell_rewards_and_evaluations() -> None:
    assert line(row(1500, 90), [], 50) == "| 1500 | 1.5 | -12.35 | 25 |  |\n"
    assert line(row(1500, 90), [4, 0], 50) == "| 1500 | 1.5 | -12.35 | 25 | 4 of 100 |\n"
    assert (percent(""), percent(None), percent("1.0")) == ("", "", "100")


def test_rest_is_told_by_the_cpu_time_of_an_env_step_since_the_gradients_began() -> None:
    timed = [row(500, 10), row(1000, 20), row(2000, 920)]
    assert projection(timed, RECIPE) == (
        "2,000 of 400,000 env steps took 15 minutes of CPU time. "
        "At 0.900 s an env step since the gradients began, evaluations included, the rest takes 99.5 hours of one core."
    )
    for early in (timed[:1], timed[:2]):
        assert "no gradient step yet" in projection(early, RECIPE)


def test_long_logs_are_thinned_and_their_evaluations_added_up() -> None:
    rows = [row(40 * number, 30 * number) for number in range(1, 106)]
    rows[50:50] = [evaluation(2000, 0.02), evaluation(2001, 0.3)]
    rows.append(evaluation(4201, 0.5))
    text = table(rows, RECIPE, "On an idle machine.")
    assert text.startswith(HEAD.format(task="peg-insertion", note="On an idle machine."))
    lines = [each for each in text.splitlines() if each.startswith("| ") and each[2].isdigit()]
    assert len(lines) == 22
    assert lines[10] == "| 2040 | 25.5 | -12.35 | 25 | 16 of 100 |"
    assert sum(each.endswith("|  |") for each in lines) == 21
    assert lines[-1].startswith("| 4200 | 52.5 |")


@pytest.mark.parametrize("rows", [[], [evaluation(0, 0.0)]], ids=["empty", "evaluated only"])
def test_a_log_in_which_nothing_is_timed_yet_is_refused_by_name(
    rows: list[dict[str, str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "curve.md"
    monkeypatch.setattr(sys, "argv", ["learning_curve.py", str(tmp_path), "--out", str(out)])
    (tmp_path / "run.json").write_text(json.dumps({"recipe": RECIPE}))
    (tmp_path / "progress.csv").write_text(f"{STEPS},{CPU_S},{EVALUATED}\n" + "".join("0,1510.0,0.0\n" for _ in rows))
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
    assert " of 400,000 env steps took " in text
