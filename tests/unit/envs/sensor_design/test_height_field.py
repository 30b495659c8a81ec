"""Outlines put into a plane mesh: close ends become one, lines are cut where others begin, needless corners go."""

from itertools import pairwise
from math import cos, hypot, pi, sin

import drawn_gels
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from vitac.envs.sensor_design.height_field import (
    HeightField,
    MeshLine,
    NotAHeightField,
    add_outlines,
    convert_to_mm,
    heights_of_faces_mm,
    snap_to_grid,
)
from vitac.envs.sensor_design.plane_mesh import GRID_PER_MM, PlaneMesh, TooManyPoints
from vitac.envs.sensor_design.surface import DrawnSurface

FloatArray = NDArray[np.float64]
CREASE_COSINE = 0.98


def length_mm(surface: DrawnSurface, *, is_wall: bool) -> float:
    lines = [line for line in HeightField(surface).lines(crease_cosine=CREASE_COSINE) if line.is_wall is is_wall]
    return float(sum(np.hypot(*np.subtract(line.second, line.first)) for line in lines))


def heights_at(surface: DrawnSurface, points: FloatArray) -> FloatArray:
    return heights_of_faces_mm(points, points, HeightField(surface).upper_corners_mm)


def test_a_box_has_walls_on_its_edge_and_no_crease() -> None:
    box = drawn_gels.flat()
    assert length_mm(box, is_wall=True) == pytest.approx(2 * (25.25 + 20.75))
    assert length_mm(box, is_wall=False) == 0.0
    assert HeightField(box).upper_slopes == pytest.approx([1.0, 1.0])


def test_a_bevel_has_creases_at_its_upper_edge_and_its_corners() -> None:
    top = 2 * (23.25 + 18.75)
    assert length_mm(drawn_gels.bevelled(), is_wall=False) == pytest.approx(top + 4 * np.sqrt(2.0))


def test_a_ridge_has_a_wall_at_its_foot_and_one_at_its_top() -> None:
    edge, ridge = 2 * (25.25 + 20.75), 2 * (2.0 + 14.0)
    assert length_mm(drawn_gels.ridge(), is_wall=True) == pytest.approx(edge + 2 * ridge)
    assert length_mm(drawn_gels.ridge(), is_wall=False) == 0.0


def test_creases_below_the_angle_are_left_away() -> None:
    field = HeightField(drawn_gels.pyramids())
    kept = [len(list(field.lines(crease_cosine=cosine))) for cosine in (-1.0, 0.7, 0.98)]
    assert kept[0] < kept[1] <= kept[2]


def test_slopes_are_cosines_to_the_base() -> None:
    slopes = HeightField(drawn_gels.pyramids()).upper_slopes
    # A pyramid 5 mm wide and 2 mm high.
    assert np.unique(slopes.round(12)) == pytest.approx([2.5 / np.hypot(2.5, 2.0), 1.0])


def test_heights_are_those_of_the_drawing() -> None:
    points = np.array([[5.0, 4.0], [5.0, 5.0], [6.5, 4.0], [2.6, 4.0], [0.0, 0.0], [-12.0, 10.0]])
    assert heights_at(drawn_gels.pyramids(), points) == pytest.approx([4.5, 3.7, 3.3, 2.58, 2.5, 2.5])


def test_heights_of_a_ramp_rise_linearly() -> None:
    x = np.linspace(-4.9, 4.9, 15)
    points = np.column_stack([x, np.zeros(15)])
    assert heights_at(drawn_gels.wedge(), points) == pytest.approx(3.5 + 0.1 * x)


def test_the_plane_of_a_face_is_continued_beyond_it() -> None:
    """Heights at corners are looked up inside, on the right side of a wall, and continued to the corner."""
    faces = HeightField(drawn_gels.wedge()).upper_corners_mm
    inside, corner = np.array([[4.9, 0.0]]), np.array([[8.0, 0.0]])
    assert heights_of_faces_mm(inside, corner, faces) == pytest.approx([4.3])


def test_a_point_beside_all_faces_takes_the_nearest() -> None:
    assert heights_at(drawn_gels.wedge(), np.array([[20.0, 0.0]])) == pytest.approx([3.0])


def test_heights_do_not_depend_on_the_order_of_points() -> None:
    points = np.random.default_rng(0).uniform(-9.0, 9.0, (50, 2))
    order = np.random.default_rng(1).permutation(50)
    dome = drawn_gels.dome(cells=9)
    np.testing.assert_array_equal(heights_at(dome, points)[order], heights_at(dome, points[order]))


def test_a_face_that_looks_down_is_named_by_its_place() -> None:
    leaning = drawn_gels.leaning(1.0)
    with pytest.raises(NotAHeightField, match=r"\d triangles face the base from above, one at \(.*\) mm, .* mm above"):
        HeightField(leaning)


def test_a_wall_that_hardly_leans_is_a_wall() -> None:
    HeightField(drawn_gels.leaning(8e-3))
    with pytest.raises(NotAHeightField):
        HeightField(drawn_gels.leaning(12e-3))


HALF_MM = (12.0, 10.0)
PlanePoint = tuple[float, float]


def line(first: PlanePoint, second: PlanePoint, *, is_wall: bool = True) -> MeshLine:
    return MeshLine(first=first, second=second, is_wall=is_wall)


def ring(points: list[PlanePoint], *, is_wall: bool = True) -> list[MeshLine]:
    return [line(points[i - 1], points[i], is_wall=is_wall) for i in range(len(points))]


def meshed(lines: list[MeshLine], *, max_points: int = 1000) -> PlaneMesh:
    plane = PlaneMesh(snap_to_grid(HALF_MM[0]), snap_to_grid(HALF_MM[1]), max_points=max_points)
    add_outlines(plane, lines, HALF_MM)
    plane.conform(shortest=0.5 * GRID_PER_MM)
    return plane


def inner_points(plane: PlaneMesh) -> set[PlanePoint]:
    """Points beside the rectangle's own corners, rounded to a thousandth of a millimetre."""
    return {(round(x, 3), round(y, 3)) for x, y in map(convert_to_mm, plane.points[4:])}


def wall_length_mm(plane: PlaneMesh) -> float:
    ends = [[convert_to_mm(plane.points[corner]) for corner in edge] for edge in plane.walls]
    return sum(hypot(a[0] - b[0], a[1] - b[1]) for a, b in ends)


@given(st.floats(-1e4, 1e4))
def test_grid_is_finer_than_a_millionth_of_a_millimetre(value_mm: float) -> None:
    x, y = convert_to_mm((snap_to_grid(value_mm), snap_to_grid(-value_mm)))
    assert abs(x - value_mm) <= 0.5 / GRID_PER_MM
    assert y == -x


def test_walls_keep_their_length_and_place() -> None:
    square = [(-3.0, -2.0), (3.0, -2.0), (3.0, 2.0), (-3.0, 2.0)]
    plane = meshed(ring(square))
    assert set(square) <= inner_points(plane)
    assert wall_length_mm(plane) == pytest.approx(20.0)


def test_creases_are_no_walls() -> None:
    plane = meshed(ring([(-3.0, -2.0), (3.0, -2.0), (0.0, 2.0)], is_wall=False))
    assert plane.walls == set()
    assert {(-3.0, -2.0), (3.0, -2.0), (0.0, 2.0)} <= inner_points(plane)


def test_a_line_that_is_crease_and_wall_is_a_wall() -> None:
    ends: tuple[PlanePoint, PlanePoint] = ((-3.0, 0.0), (3.0, 0.0))
    for order in ((True, False), (False, True)):
        plane = meshed([line(*ends, is_wall=is_wall) for is_wall in order])
        assert wall_length_mm(plane) == pytest.approx(6.0)


def test_lines_on_the_edge_of_the_base_are_left_away() -> None:
    edge = ring([(-12.0, -10.0), (12.0, -10.0), (12.0, 10.0), (-12.0, 10.0)])
    assert meshed(edge).walls == set()
    # Within the snap of 0.01 mm, too.
    assert meshed([line((-12.0, 9.995), (12.0, 10.0))]).walls == set()
    assert wall_length_mm(meshed([line((-11.0, 9.9), (11.0, 9.9))])) == pytest.approx(22.0)


def test_ends_that_are_close_become_one_point() -> None:
    plane = meshed([line((-3.0, 0.0), (0.0, 0.0)), line((0.006, -0.007), (0.0, 4.0))])
    assert inner_points(plane) >= {(-3.0, 0.0), (0.0, 0.0), (0.0, 4.0)}
    assert not any(0.0 < abs(x) + abs(y) < 0.1 for x, y in inner_points(plane))


def test_a_line_is_cut_where_another_ends_on_it() -> None:
    crossing = [line((-4.0, 0.0), (4.0, 0.0)), line((1.0, 0.0), (1.0, 5.0))]
    assert (1.0, 0.0) in inner_points(meshed(crossing))


def test_a_line_drawn_twice_or_backwards_counts_once() -> None:
    once = [line((-4.0, 0.0), (4.0, 0.0))]
    twice = [*once, *once, line((4.0, 0.0), (-4.0, 0.0))]
    assert sorted(meshed(twice).points) == sorted(meshed(once).points)
    assert meshed(twice).walls == meshed(once).walls


def test_corners_that_hardly_matter_are_left_away() -> None:
    for off_mm, is_kept in ((0.03, False), (0.05, True)):
        plane = meshed([line((-4.0, 0.0), (0.5, off_mm)), line((0.5, off_mm), (4.0, 0.0))])
        assert ((0.5, off_mm) in inner_points(plane)) is is_kept


def test_a_fine_circle_becomes_a_coarse_one_of_nearly_its_length() -> None:
    circle = [(4.0 * cos(2 * pi * i / 180), 4.0 * sin(2 * pi * i / 180)) for i in range(180)]
    plane = meshed(ring(circle))
    on_circle = [(x, y) for x, y in inner_points(plane) if abs(x * x + y * y - 16.0) < 0.1]
    assert len(on_circle) < 60
    assert wall_length_mm(plane) == pytest.approx(2 * pi * 4.0, rel=0.01)


def test_a_chain_that_is_cut_beside_its_end_again_and_again_is_no_trouble() -> None:
    """As many cuts in each other as it has corners, more than Python calls may be nested."""
    fading = [(-11.5 + 0.0115 * i, (1 - 2 * (i % 2)) * (9.0 - 0.004 * i)) for i in range(2000)]
    with pytest.raises(TooManyPoints, match="More than 1000 points"):
        meshed([line(a, b) for a, b in pairwise(fading)])


def test_a_corner_where_three_lines_meet_stays() -> None:
    star = [line((-4.0, 0.0), (0.0, 0.02)), line((0.0, 0.02), (4.0, 0.0)), line((0.0, 0.02), (0.0, 5.0))]
    assert (0.0, 0.02) in inner_points(meshed(star))


def test_order_of_the_lines_does_not_change_the_mesh() -> None:
    lines = [*ring([(-3.0, -2.0), (3.0, -2.0), (3.0, 2.0)]), line((-8.0, 5.0), (8.0, 5.0), is_wall=False)]
    assert meshed(lines).points == meshed(lines[::-1]).points


def test_no_lines_leave_the_rectangle_as_it_is() -> None:
    assert len(meshed([]).points) == 4


def test_more_corners_than_points_are_refused() -> None:
    comb = [line((x / 4.0, -5.0), (x / 4.0, 5.0)) for x in range(-40, 41)]
    with pytest.raises(TooManyPoints, match="More than 100 points"):
        meshed(comb, max_points=100)


def test_an_absurd_number_of_corners_is_refused_before_it_takes_long() -> None:
    zigzag = [(-11.0 + i * 0.011, 5.0 * (i % 2) + 0.002 * i) for i in range(2000)]
    lines = [line(a, b) for a, b in pairwise(zigzag)]
    lines += [line((x, y - 9.0), (x2, y2 - 9.0)) for (x, y), (x2, y2) in pairwise(zigzag)]
    lines += [line((11.5, -9.0), (11.5, -8.0)), line((11.6, -9.0), (11.6, -8.0))]
    with pytest.raises(TooManyPoints, match="outlines of the faces have more than 4000 corners"):
        meshed(lines)
