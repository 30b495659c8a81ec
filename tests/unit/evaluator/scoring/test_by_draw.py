"""Success against a quantity that was drawn for every episode."""

import pytest
from vitac.envs.tasks.insertion.interface import INSERTION_QUANTITIES
from vitac.evaluator.scoring.by_draw import RateOfPart, is_monotone, rates_by_draw
from vitac.evaluator.scoring.score import rate

CLEARANCE, BESIDE = (
    next(quantity for quantity in INSERTION_QUANTITIES if quantity.name == name)
    for name in ("clearance_mm", "gripper_x_mm")
)


def test_a_range_is_cut_into_equal_parts_and_ends_belong_to_the_outer_ones() -> None:
    parts = rates_by_draw(CLEARANCE, (0.5, 2.5), [(0.5, False), (0.9, True), (1.0, True), (2.5, True)])
    assert [(part.low, part.high, part.rate.successes, part.rate.episodes) for part in parts] == [
        (0.5, 1.0, 1, 2),
        (1.0, 1.5, 1, 1),
        (2.0, 2.5, 1, 1),
    ]


def test_a_two_sided_quantity_counts_by_its_distance_from_the_nominal_value() -> None:
    parts = rates_by_draw(BESIDE, (-4.0, 2.0), [(-3.5, False), (0.5, True), (-0.5, True)])
    assert [(part.low, part.rate.success_rate) for part in parts] == [(0.0, 1.0), (3.0, 0.0)]


@pytest.mark.parametrize(
    ("solved", "expected"), [((5, 20, 60), True), ((60, 20, 5), True), ((50, 46, 52), True), ((60, 10, 60), False)]
)
def test_rates_are_monotone_where_such_a_line_lies_within_all_intervals(
    solved: tuple[int, ...], expected: bool
) -> None:
    parts = [RateOfPart(low=k, high=k + 1, rate=rate(count, 100)) for k, count in enumerate(solved)]
    assert is_monotone(parts) is expected
