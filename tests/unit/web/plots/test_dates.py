import re
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from uuid import UUID

import yaml
from vitac.envs.tasks.definition import Better
from vitac.evaluator.ranking import RankingKey
from vitac.evaluator.strict_model import parse_yaml
from vitac.evaluator.tracks import Track
from vitac.server.views.leaderboards import DatedRankView, TeamRanksView
from vitac.web.plots.dates import DatedValue, ranks_by_date, success_by_delay, values_by_date
from vitac.web.plots.files import write_pdf, write_svg

START = datetime(2026, 11, 1, 12, tzinfo=UTC)


def rates(*values: float) -> list[DatedValue]:
    return [
        DatedValue(name=f"<{number}>", at=START + timedelta(days=number), value=value, own=number == 1)
        for number, value in enumerate(values)
    ]


def test_points_rise_with_rate_and_go_right_with_time() -> None:
    figure = values_by_date("h", "History", rates(0.0, 0.5, 1.0))
    points = [(float(x), float(y)) for x, y in re.findall(r'cx="([\d.]+)" cy="([\d.]+)"', figure.drawing)]
    assert points == [(70.0, 190.0), (313.0, 102.0), (556.0, 14.0)]
    assert figure.drawing.count("point own") == 1


def test_the_line_is_the_best_so_far() -> None:
    path = re.search(r'class="best" d="([^"]+)"', values_by_date("h", "History", rates(0.5, 0.25, 0.75)).drawing)
    assert path is not None
    assert path[1] == "M70.00 102.00H556.00V58.00H556.00"


def test_the_order_of_the_input_does_not_matter() -> None:
    given = rates(0.5, 0.25, 0.75)
    assert values_by_date("h", "History", given[::-1]) == values_by_date("h", "History", given)


def test_one_point_and_one_day_are_drawn() -> None:
    figure = values_by_date("h", "History", rates(0.5))
    assert figure.drawing.count("<circle") == 1
    assert figure.drawing.count("2026-11-01 12:00</text>") == 1
    assert "the best is <0> with 50.0" in figure.summary


def test_names_are_escaped_in_the_drawing_and_kept_in_the_table() -> None:
    figure = values_by_date("h", "History", rates(0.5, 0.6))
    assert "&lt;0&gt;" in figure.drawing
    assert "<0>" not in figure.drawing
    assert [row[1] for row in figure.table.rows] == ["<0>", "<1>"]


def test_of_a_measure_of_which_less_is_better_the_line_goes_down_to_the_best() -> None:
    degrees = RankingKey(
        name="error_deg", title="Error [degree]", unit="degree", better=Better.LOW, words="lower error"
    )
    figure = values_by_date("h", "History", rates(8.0, 10.0, 2.5), degrees)
    path = re.search(r'class="best" d="([^"]+)"', figure.drawing)
    assert path is not None
    heights = [float(height) for height in re.findall(r"V([0-9.]+)", path[1])]
    assert len(heights) == 1, "10 is no better than 8"
    assert heights[0] > float(path[1].split()[1].split("H")[0]), "2.5 is drawn below 8"
    assert "the best is <2> with 2.5" in figure.summary
    assert figure.table.columns[-1] == "Error [degree]"
    assert [row[-1] for row in figure.table.rows] == ["8", "10", "2.5"]
    assert "%" not in str(figure.drawing)


def test_dates_are_those_of_utc_and_four_are_written_at_equal_distances() -> None:
    figure = values_by_date("h", "History", rates(0.1, 0.2, 0.3, 0.4))
    written = re.findall(r'x="([\d.]+)" y="212"[^>]*>([\d-]+)<', figure.drawing)
    assert [date for _, date in written] == ["2026-11-01", "2026-11-02", "2026-11-03", "2026-11-04"]
    assert [float(x) for x, _ in written] == [70.0, 232.0, 394.0, 556.0]
    west = [DatedValue(name="w", at=datetime(2026, 10, 31, 22, tzinfo=timezone(-timedelta(hours=5))), value=0.5)]
    assert values_by_date("h", "History", west).table.rows == (("2026-11-01 03:00", "w", "50.0\N{NO-BREAK SPACE}%"),)


def test_submissions_of_one_day_have_their_minutes() -> None:
    hours = [DatedValue(name=f"{n}", at=START + timedelta(hours=n), value=0.5) for n in range(4)]
    figure = values_by_date("h", "History", hours)
    written = re.findall(r'y="212"[^>]*>([^<]+)<', figure.drawing)
    assert written == [f"11-01 {hour}:00" for hour in (12, 13, 14, 15)]
    assert [row[0] for row in figure.table.rows] == [f"2026-{text}" for text in written]
    assert "0, 2026-11-01 12:00: 50.0" in figure.drawing
    assert len(set(re.findall(r'cx="([\d.]+)"', figure.drawing))) == 4


def test_days_that_would_be_written_twice_have_their_minutes() -> None:
    figure = values_by_date("h", "History", rates(0.1, 0.2, 0.3))
    written = re.findall(r'y="212"[^>]*>([^<]+)<', figure.drawing)
    assert written == ["11-01 12:00", "11-02 04:00", "11-02 20:00", "11-03 12:00"]


def test_a_line_that_never_rises_stays_where_it_began() -> None:
    path = re.search(r'class="best" d="([^"]+)"', values_by_date("h", "History", rates(0.5, 0.5, 0.25)).drawing)
    assert path is not None
    assert path[1] == "M70.00 102.00H556.00"


def test_of_equal_rates_the_earliest_is_called_the_best() -> None:
    summary = values_by_date("h", "History", rates(0.25, 0.75, 0.75)).summary
    assert summary.startswith("3 from 2026-11-01 to 2026-11-03; the best is <1> with 75.0")


def test_ranks_over_time_are_a_line_for_each_team_with_its_name_and_a_row_for_each_change() -> None:
    teams = [
        TeamRanksView(
            team=name,
            submission_id=UUID(int=1),
            ranks=[DatedRankView(at=START + timedelta(days=day), rank=place) for day, place in ranks],
        )
        for name, ranks in (("A team with a very long name", [(0, 1), (1, 2), (3, 1)]), ("Bees", [(1, 1), (3, 2)]))
    ]
    found = ranks_by_date("ranks", "Ranks", teams, START + timedelta(days=4))
    assert ">A team with a ver…<" in found.drawing
    assert len(found.table.rows) == 5
    assert "first is now A team" in found.summary
    first, second = re.findall(r'd="M[0-9.]+ ([0-9.]+)[^"]*V([0-9.]+)H440.00"', found.drawing)
    assert first == (first[0], first[0]), "first at the begin and at the end"
    assert second[0] == first[0] < second[1]
    assert re.findall(r">([0-9.]+)<", found.drawing) == ["1", "2"], "there is no rank between"


def test_no_minute_is_written_twice_below_a_plot() -> None:
    begun = datetime(2026, 11, 26, 5, 34, 40, tzinfo=UTC)
    rates = [DatedValue(name=str(seconds), at=begun + timedelta(seconds=seconds), value=0.5) for seconds in (0, 30)]
    assert re.findall(r">(11-26 [0-9:]+)<", values_by_date("key", "title", rates).drawing) == [
        "11-26 05:34",
        "11-26 05:35",
    ]


TRACK_1 = Path(__file__).parents[4] / "evaluator" / "tracks" / "track_1.yaml"


def delayed_track() -> Track:
    content = yaml.safe_load(TRACK_1.read_text())
    content["tasks"]["peg-insertion"] |= {"control_period_ms": 50, "delays_ms": [0, 50, 200]}
    return parse_yaml(Track, yaml.safe_dump(content), "track_1.yaml")


def entry(team: str, **successes: int) -> Any:
    scores = [
        SimpleNamespace(
            task=task.replace("_", "-"), success_rate=solved / 10, successes=solved, episodes=10,
            success_rate_interval=(0.1, 0.9),
        )
        for task, solved in successes.items()
    ]  # fmt: skip
    return SimpleNamespace(team=team, scores=scores)


def test_the_best_entries_are_drawn_against_the_delays_that_they_have_played() -> None:
    entries = [
        entry("Ants", peg_insertion=9, peg_insertion_50ms=6, peg_insertion_200ms=1, lock_opening=8),
        entry("Bees", peg_insertion=8, peg_insertion_200ms=2),
        entry("Cats", peg_insertion=7),
    ]
    (figure,) = success_by_delay(delayed_track(), entries)
    assert figure.title == "Peg insertion: success rate against delay [ms]"
    assert (
        figure.summary.replace("\N{NO-BREAK SPACE}", " ") == "Ants: 90.0 % at 0 ms, 60.0 % at 50 ms, 10.0 % at 200 ms."
    )
    assert [row[:3] for row in figure.table.rows] == [
        ("Ants", "0", "9 of 10"), ("Ants", "50", "6 of 10"), ("Ants", "200", "1 of 10"),
        ("Bees", "0", "8 of 10"), ("Bees", "200", "2 of 10"),
    ]  # fmt: skip
    assert figure.drawing.count('class="best"') == 2
    assert "Cats" not in figure.drawing
    assert write_svg(figure).startswith(b"<")
    assert write_pdf(figure).startswith(b"%PDF")


def test_a_track_without_delays_has_no_plot() -> None:
    track = parse_yaml(Track, TRACK_1.read_text(), "track_1.yaml")
    assert success_by_delay(track, [entry("Ants", peg_insertion=9, lock_opening=8)]) == []
