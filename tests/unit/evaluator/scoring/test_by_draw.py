"""Success against a quantity that was drawn for every episode."""

from vitac.envs.tasks.insertion.interface import INSERTION_QUANTITIES
from vitac.evaluator.scoring.comparison import rates_by_draw

CLEARANCE, BESIDE = (
    next(quantity for quantity in INSERTION_QUANTITIES if quantity.name == name)
    for name in ("clearance_mm", "gripper_x_mm")
)


def test_a_range_is_cut_into_equal_parts_and_ends_belong_to_the_outer_ones() -> None:
    parts = rates_by_draw(CLEARANCE, (0.5, 2.5), [(0.5, 1, False), (0.9, 2, True), (1.0, 3, True), (2.5, 4, True)])
    assert [(part.low, part.high, part.rate.successes, part.rate.episodes) for part in parts] == [
        (0.5, 1.0, 1, 2),
        (1.0, 1.5, 1, 1),
        (2.0, 2.5, 1, 1),
    ]


def test_a_two_sided_quantity_counts_by_its_distance_from_the_nominal_value() -> None:
    parts = rates_by_draw(BESIDE, (-4.0, 2.0), [(-3.5, 1, False), (0.5, 2, True), (-0.5, 3, True)])
    assert [(part.low, part.rate.success_rate) for part in parts] == [(0.0, 1.0), (3.0, 0.0)]
