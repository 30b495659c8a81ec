"""What a terminal and a pipe see of a running evaluation."""

import io
from typing import Any

import pytest
from rich.console import Console
from vitac.cli.client.progress import EvaluationProgress, situation


def state(*done: int, total: int = 50, successes: int = 0, **changes: Any) -> dict[str, Any]:
    """A submission as the API sends it; for each task how many episodes are done."""
    names = ("peg-insertion", "lock-opening")
    tasks = [
        {"task": name, "episodes_done": count, "episodes_total": total, "successes": successes}
        for name, count in zip(names, done, strict=False)
    ]
    progress = {
        "episodes_done": sum(done),
        "episodes_total": total * len(done),
        "successes": successes * len(done),
        "tasks": tasks,
    }
    evaluation = {"state": "running", "queue_position": None, "eta_s": None, "progress": progress, **changes}
    return {"evaluation": evaluation, "workers": {"alive": 2}}


def shown(*states: dict[str, Any], terminal: bool = False, **options: Any) -> str:
    text = io.StringIO()
    console = Console(file=text, force_terminal=terminal, width=200, color_system=None)
    with EvaluationProgress(console=console, **options) as progress:
        for found in states:
            progress.update(found)
    return text.getvalue()


def test_a_pipe_gets_a_line_for_every_tenth() -> None:
    lines = shown(*(state(done, successes=done // 2) for done in range(51))).splitlines()
    assert lines == [f"{done}/50 episodes, {done // 2} successes" for done in range(5, 51, 5)]


def test_a_pipe_gets_one_line_for_many_tenths_at_once() -> None:
    assert shown(state(0), state(37), state(38), state(50)).splitlines() == [
        "37/50 episodes, 0 successes",
        "50/50 episodes, 0 successes",
    ]


def test_a_pipe_is_told_once_why_nothing_goes_on() -> None:
    alone = state(0) | {"workers": {"alive": 0}}
    assert shown(alone, alone, state(0), alone).splitlines() == 2 * ["waiting: no worker is running"]


def test_a_state_that_is_shown_again_prints_nothing() -> None:
    assert shown(state(25), state(25), state(25)).splitlines() == ["25/50 episodes, 0 successes"]


def test_several_tasks_stand_behind_the_sum() -> None:
    (line,) = shown(state(50, 0)).splitlines()
    assert line == "50/100 episodes, 0 successes (peg-insertion 50/50, lock-opening 0/50)"


def test_lines_are_indented_and_not_broken() -> None:
    (line,) = shown(state(1000, 1000, total=1000), indent=4).splitlines()
    assert line.startswith("    2000/2000 episodes")


@pytest.mark.parametrize("terminal", [True, False])
def test_a_quiet_one_shows_nothing(terminal: bool) -> None:
    assert shown(state(50), terminal=terminal, quiet=True) == ""


def test_a_terminal_sees_a_bar_with_what_is_done() -> None:
    text = shown(state(0), state(20, successes=7, eta_s=30.4), terminal=True)
    assert "20/50" in text
    assert "7 successes" in text
    assert "about 30 s left" in text
    assert "peg-insertion" not in text


def test_a_terminal_sees_one_bar_of_a_sealed_list_to_the_end() -> None:
    begun, over = state(20, 20), state(50, 50, successes=7)
    begun["evaluation"]["progress"] |= {"tasks": [], "successes": None}
    first, text = shown(begun, terminal=True), shown(begun, over, terminal=True)
    assert "40/100 hidden successes" in first
    assert "100/100" in text
    assert "14 successes" in text
    assert "peg-insertion" not in text


def test_a_terminal_sees_a_bar_for_each_of_several_tasks() -> None:
    text = shown(state(50, 10, eta_s=99.0), terminal=True)
    assert "peg-insertion" in text
    assert "lock-opening" in text
    finished = [line for line in text.splitlines() if "50/50" in line]
    assert finished
    assert not any("left" in line for line in finished)


@pytest.mark.parametrize(
    ("changes", "alive", "words"),
    [
        ({"state": "queued", "queue_position": 3}, 2, "number 3 in the queue"),
        ({"state": "queued", "queue_position": 3}, 0, "no worker is running"),
        ({"state": "running", "eta_s": 12.6}, 0, "no worker is running"),
        ({"state": "running", "eta_s": 12.6}, 1, "about 13 s left"),
        ({"state": "running", "eta_s": 0.0}, 1, "about 0 s left"),
        ({"state": "running"}, 1, ""),
        ({"state": "completed"}, 0, ""),
        ({"state": "failed"}, 0, ""),
    ],
)
def test_the_situation_is_said_in_a_few_words(changes: dict[str, Any], alive: int, words: str) -> None:
    assert situation({**state(1, **changes), "workers": {"alive": alive}}) == words
