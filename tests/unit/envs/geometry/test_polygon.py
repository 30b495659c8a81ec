import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from polygon_area import signed_area
from vitac.envs.geometry.pegs import PLATE_OUTLINE_MM, PROFILES_MM, PegShape, hole_outline_mm
from vitac.envs.geometry.polygon import (
    as_polygon,
    boundaries_touch,
    contains,
    mitred_offset,
    overlaps_plate,
    segments_touch,
)
from vitac.envs.geometry.solid import rectangle

SQUARE = rectangle(-1.0, 1.0, -1.0, 1.0)


def test_area_is_positive_counter_clockwise_and_negative_clockwise() -> None:
    assert signed_area(SQUARE) == 4.0
    assert signed_area(SQUARE[::-1]) == -4.0


@given(st.floats(0.01, 5.0))
def test_offset_of_a_rectangle_widens_each_side_by_the_distance(distance: float) -> None:
    assert mitred_offset(SQUARE, distance) == pytest.approx(SQUARE * (1.0 + distance))


@pytest.mark.parametrize("shape", PegShape)
def test_offset_edges_run_parallel_at_the_distance(shape: PegShape) -> None:
    profile, outline = PROFILES_MM[shape], hole_outline_mm(shape)
    for i in range(len(profile)):
        direction = profile[i] - profile[i - 1]
        normal = np.array([direction[1], -direction[0]]) / np.hypot(*direction)
        assert (outline[i] - profile[i]) @ normal == pytest.approx(1.5)
        assert (outline[i - 1] - profile[i - 1]) @ normal == pytest.approx(1.5)


def test_offset_of_reflex_corners_moves_them_outwards_too() -> None:
    outline = hole_outline_mm(PegShape.CONCAVE1)
    assert outline[2] == pytest.approx([13.2265, -4.5981], abs=1e-4)
    assert outline[0] == pytest.approx([-20.0981, -16.5], abs=1e-4)


@pytest.mark.parametrize(
    ("second", "touch"),
    [
        (((0, -1), (0, 1)), True),
        (((2, -1), (2, 1)), False),
        (((1, 0), (2, 0)), True),
        (((1.5, 0), (2, 0)), False),
        (((1, 0), (1, 5)), True),
        (((-1, 0.1), (1, 0.1)), False),
    ],
)
def test_segments_touch_where_they_cross_meet_or_overlap(second: tuple[tuple[float, float], ...], touch: bool) -> None:
    a, b = np.array([-1.0, 0.0]), np.array([1.0, 0.0])
    c, d = np.array(second, dtype=np.float64)
    assert segments_touch(a, b, c, d) is touch
    assert segments_touch(d, c, b, a) is touch


@given(st.floats(-2, 2), st.floats(-2, 2))
def test_contains_agrees_with_the_box_test_for_a_square(x: float, y: float) -> None:
    if abs(abs(x) - 1) > 1e-9 and abs(abs(y) - 1) > 1e-9:
        assert contains(SQUARE, np.array([x, y])) == (abs(x) < 1 and abs(y) < 1)


def test_contains_sees_the_notch_of_a_concave_polygon() -> None:
    bow_tie = PROFILES_MM[PegShape.CONCAVE1]
    assert not contains(bow_tie, np.array([15.0, 0.0]))
    assert contains(bow_tie, np.array([11.0, 0.0]))
    assert contains(bow_tie, np.array([15.0, 14.0]))


@pytest.mark.parametrize("shape", PegShape)
def test_aligned_peg_passes_its_hole(shape: PegShape) -> None:
    assert not overlaps_plate(PROFILES_MM[shape], plate=PLATE_OUTLINE_MM, hole=hole_outline_mm(shape))


@pytest.mark.parametrize("shape", PegShape)
@pytest.mark.parametrize("shift", [(1.51, 0.0), (-1.51, 0.0), (0.0, 1.51), (0.0, -1.51)])
def test_peg_shifted_by_more_than_the_clearance_is_blocked(shape: PegShape, shift: tuple[float, float]) -> None:
    hole = hole_outline_mm(shape)
    sideways_slope = shape is PegShape.TRAPEZOID and shift[0] != 0
    factor = 1.1 if sideways_slope else 1.0
    assert overlaps_plate(PROFILES_MM[shape] + np.array(shift) * factor, plate=PLATE_OUTLINE_MM, hole=hole)
    assert not overlaps_plate(PROFILES_MM[shape] + np.array(shift) * 0.99, plate=PLATE_OUTLINE_MM, hole=hole)


def test_touching_the_rim_counts_as_blocked() -> None:
    hole = hole_outline_mm(PegShape.CUBOID)
    moved = PROFILES_MM[PegShape.CUBOID] + np.array([1.5, 0.0])
    assert overlaps_plate(moved, plate=PLATE_OUTLINE_MM, hole=hole)


def test_polygon_within_the_material_off_the_plate_or_around_the_hole() -> None:
    plate, hole = rectangle(-10, 10, -10, 10), rectangle(-2, 2, -2, 2)
    assert overlaps_plate(SQUARE + 5.0, plate=plate, hole=hole)
    assert not overlaps_plate(SQUARE + 50.0, plate=plate, hole=hole)
    assert not overlaps_plate(SQUARE, plate=plate, hole=hole)
    assert overlaps_plate(SQUARE * 4.0, plate=plate, hole=hole)
    assert overlaps_plate(SQUARE * 20.0, plate=plate, hole=hole)


def test_boundaries_of_nested_polygons_do_not_touch() -> None:
    assert not boundaries_touch(SQUARE, SQUARE * 2.0)
    assert boundaries_touch(SQUARE, SQUARE + 1.0)


def test_polygon_keeps_the_order_of_its_corners() -> None:
    assert as_polygon([(0, 1), (2, 3)]).tolist() == [[0.0, 1.0], [2.0, 3.0]]
