import re
from datetime import UTC, datetime, timedelta

from vitac.web.plots.dates import DatedRate, rates_by_date

START = datetime(2026, 11, 1, 12, tzinfo=UTC)


def rates(*values: float) -> list[DatedRate]:
    return [
        DatedRate(name=f"<{number}>", at=START + timedelta(days=number), success_rate=value, own=number == 1)
        for number, value in enumerate(values)
    ]


def test_points_rise_with_rate_and_go_right_with_time() -> None:
    figure = rates_by_date("h", "History", rates(0.0, 0.5, 1.0))
    points = [(float(x), float(y)) for x, y in re.findall(r'cx="([\d.]+)" cy="([\d.]+)"', figure.drawing)]
    assert points == [(70.0, 190.0), (313.0, 102.0), (556.0, 14.0)]
    assert figure.drawing.count("point own") == 1


def test_the_line_is_the_best_so_far() -> None:
    path = re.search(r'class="best" d="([^"]+)"', rates_by_date("h", "History", rates(0.5, 0.25, 0.75)).drawing)
    assert path is not None
    assert path[1] == "M70.00 102.00H556.00V58.00H556.00"


def test_the_order_of_the_input_does_not_matter() -> None:
    given = rates(0.5, 0.25, 0.75)
    assert rates_by_date("h", "History", given[::-1]) == rates_by_date("h", "History", given)


def test_one_point_and_one_day_are_drawn() -> None:
    figure = rates_by_date("h", "History", rates(0.5))
    assert figure.drawing.count("<circle") == 1
    assert figure.drawing.count("2026-11-01</text>") == 1
    assert "the best is <0> with 50.0" in figure.summary


def test_names_are_escaped_in_the_drawing_and_kept_in_the_table() -> None:
    figure = rates_by_date("h", "History", rates(0.5, 0.6))
    assert "&lt;0&gt;" in figure.drawing
    assert "<0>" not in figure.drawing
    assert [row[1] for row in figure.table.rows] == ["<0>", "<1>"]
