import io
import re
from collections.abc import Iterable

import pytest
from rich.console import Console
from vitac.cli.client.progress import EvaluationProgress, situation
from vitac.cli.demo.display import BAR_WIDTH, DemoDisplay, interval_bar


def board(*entries: dict[str, object], keys: Iterable[str] = ("success_rate", "mean_steps")) -> dict[str, object]:
    ranking = {"keys": [{"name": name, "title": f"{name} [mm]"} for name in (*keys, "submitted_at")]}
    return {
        "title": "Tactile manipulation",
        "task": None,
        "is_practice": True,
        "entries": list(entries),
        "ranking": ranking,
    }


def entry(
    rank: int | None, team: str, rate: float, interval: tuple[float, float] = (0.4, 0.6), tasks: int = 1
) -> dict[str, object]:
    shapes = [{"shape": "cuboid", "success_rate": rate}]
    return {
        "rank": rank,
        "team": team,
        "success_rate": rate,
        "success_rate_interval": interval,
        "mean_steps": None if rate == 0 else 4.5,
        "measures": {"travel": 2.933},
        "scores": [{"task": f"task-{n}", "success_rate": rate, "shapes": shapes} for n in range(tasks)],
    }


def shown(*, terminal: bool, encoding: str = "utf-8") -> tuple[DemoDisplay, io.BytesIO]:
    raw = io.BytesIO()
    file = io.TextIOWrapper(raw, encoding=encoding, errors="replace", write_through=True)
    return DemoDisplay(Console(file=file, force_terminal=terminal, width=80, highlight=False)), raw


def plain(raw: io.BytesIO, encoding: str = "utf-8") -> str:
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", raw.getvalue().decode(encoding))


def found(state: str = "running", done: int = 0, alive: int = 1, eta: float | None = None) -> dict[str, object]:
    counts = {"episodes_done": done, "episodes_total": 270, "successes": done // 2}
    progress = counts | {"tasks": [counts | {"task": "peg-insertion"}]}
    evaluation = {
        "state": state,
        "progress": progress,
        "queue_position": 3 if state == "queued" else None,
        "eta_s": eta,
    }
    return {"evaluation": evaluation, "workers": {"alive": alive}}


def test_a_step_is_one_line_with_its_result() -> None:
    display, raw = shown(terminal=False)
    with display.stage("Service") as stage:
        stage.done("http://127.0.0.1:8000")
    assert plain(raw).startswith("  ✓ Service      http://127.0.0.1:8000")
    assert plain(raw).count("\n") == 1


def test_a_long_step_says_in_a_pipe_what_it_waits_for() -> None:
    display, raw = shown(terminal=False)
    with display.stage("Physics", "compiling") as stage:
        stage.done("compiled")
    assert plain(raw).splitlines()[0] == "  · Physics: compiling"


def test_a_step_that_fails_is_not_marked_as_done() -> None:
    display, raw = shown(terminal=True)
    with pytest.raises(ValueError, match="no"), display.stage("Service", "starting"):
        raise ValueError("no")
    assert "✓" not in plain(raw)


def test_marks_are_plain_where_the_encoding_has_no_others() -> None:
    display, raw = shown(terminal=False, encoding="ascii")
    with display.stage("Service") as stage:
        stage.done("here")
    display.leaderboard(board(entry(1, "demo", 0.5)), "demo")
    assert plain(raw, "ascii").startswith("  + Service      here")


@pytest.mark.parametrize("terminal", [True, False])
def test_the_leaderboard_fits_eighty_columns(terminal: bool) -> None:
    display, raw = shown(terminal=terminal)
    display.leaderboard(board(entry(1, "demo", 0.5), entry(None, "a team with a very long name", 0.0)), "demo")
    printed = plain(raw)
    assert max(len(line) for line in printed.splitlines()) <= 80
    for part in ("50.0 %", "40.0 to 60.0 %", "4.50", "demo by shape: cuboid 50.0 %", "…"):
        assert part in printed


def test_a_board_that_ranks_by_a_measure_shows_it_in_place_of_env_steps() -> None:
    display, raw = shown(terminal=False)
    display.leaderboard(board(entry(1, "demo", 0.5), keys=("success_rate", "travel")), "demo")
    heading, row = [line.split() for line in plain(raw).splitlines() if "Rank" in line or "demo" in line][:2]
    assert heading[-2:] == ["travel", "[mm]"]
    assert row[-1] == "2.93"
    assert "Env steps" not in plain(raw)


def test_of_several_tasks_the_leaderboard_says_the_rate_of_each() -> None:
    display, raw = shown(terminal=False)
    display.leaderboard(board(entry(1, "demo", 0.5, tasks=2)), "demo")
    assert "demo by task: task-0 50.0 %, task-1 50.0 %" in plain(raw)
    assert "all tasks: practice board of the public list" in plain(raw)


@pytest.mark.parametrize(("rate", "place"), [(0.0, 0), (0.5, BAR_WIDTH // 2), (1.0, BAR_WIDTH - 1)])
def test_the_rate_is_a_dot_at_its_place(rate: float, place: int) -> None:
    bar = interval_bar(rate, max(0.0, rate - 0.1), min(1.0, rate + 0.1)).plain
    assert len(bar) == BAR_WIDTH
    assert bar.index("●") == place
    assert "━" in bar


def test_a_pipe_gets_a_line_for_each_tenth() -> None:
    file = io.StringIO()
    with EvaluationProgress(console=Console(file=file, width=80)) as progress:
        for done in range(271):
            progress.update(found(done=done))
    assert file.getvalue().splitlines()[0] == "27/270 episodes, 13 successes"
    assert len(file.getvalue().splitlines()) == 10


def test_a_terminal_gets_one_bar() -> None:
    file = io.StringIO()
    with EvaluationProgress(console=Console(file=file, width=120, force_terminal=True)) as progress:
        progress.update(found(done=135, eta=41.2))
    assert "135/270" in file.getvalue()
    assert "about 41 s left" in file.getvalue()


def test_each_of_several_tasks_has_its_bar_and_its_share_of_a_line() -> None:
    running = found(done=135)
    waiting = {"task": "lock-opening", "episodes_done": 0, "episodes_total": 160, "successes": 0}
    running["evaluation"]["progress"]["tasks"].append(waiting)  # type: ignore[index]
    bars, lines = io.StringIO(), io.StringIO()
    with EvaluationProgress(console=Console(file=bars, width=120, force_terminal=True)) as progress:
        progress.update(running)
    with EvaluationProgress(console=Console(file=lines, width=40)) as progress:
        progress.update(running)
    for part in ("peg-insertion", "135/270", "lock-opening", "0/160"):
        assert part in bars.getvalue()
    assert lines.getvalue().endswith("67 successes (peg-insertion 135/270, lock-opening 0/160)\n")


def test_quiet_is_quiet() -> None:
    file = io.StringIO()
    with EvaluationProgress(quiet=True, console=Console(file=file)) as progress:
        progress.update(found(done=270))
    assert file.getvalue() == ""


def test_says_what_an_evaluation_waits_for() -> None:
    assert situation(found(alive=0)) == "no worker is running"
    unable = found(alive=0)
    unable["workers"]["missing_family"] = "maniskill"  # type: ignore[index]
    assert situation(unable) == "no running worker has what maniskill needs"
    assert situation(found(state="queued")) == "number 3 in the queue"
    assert situation(found(eta=12.4)) == "about 12 s left"
    assert situation(found(state="completed", alive=0)) == ""
