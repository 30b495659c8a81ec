from itertools import pairwise
from math import acos, degrees, hypot

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vitac.envs.sensor_design.plane_mesh import GRID_PER_MM, PlaneMesh, TooManyPoints

HALF_X, HALF_Y = 12 * GRID_PER_MM, 10 * GRID_PER_MM
coordinates = st.tuples(st.integers(-HALF_X, HALF_X), st.integers(-HALF_Y, HALF_Y))


def with_square(half_mm: float, *, max_points: int = 1000) -> PlaneMesh:
    mesh = PlaneMesh(HALF_X, HALF_Y, max_points=max_points)
    half = round(half_mm * GRID_PER_MM)
    corners = [mesh.add_point(point) for point in ((-half, -half), (half, -half), (half, half), (-half, half))]
    for i in range(4):
        mesh.add_segment(corners[i - 1], corners[i], is_wall=True)
    return mesh


def double_area(mesh: PlaneMesh) -> int:
    total = 0
    for a, b, c in ([mesh.points[corner] for corner in triangle] for triangle in mesh.triangles):
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        assert area > 0
        total += area
    return total


def smallest_angle(mesh: PlaneMesh) -> float:
    angles = []
    for triangle in mesh.triangles:
        points = [mesh.points[corner] for corner in triangle]
        for i in range(3):
            (ux, uy), (vx, vy) = ((points[k][0] - points[i][0], points[k][1] - points[i][1]) for k in (i - 1, i - 2))
            angles.append(degrees(acos((ux * vx + uy * vy) / hypot(ux, uy) / hypot(vx, vy))))
    return min(angles)


@settings(max_examples=40)
@given(st.lists(coordinates, max_size=30))
def test_any_points_are_triangulated_without_gap_or_overlap(points: list[tuple[int, int]]) -> None:
    mesh = PlaneMesh(HALF_X, HALF_Y, max_points=100)
    for point in points:
        assert mesh.points[mesh.add_point(point)] == point
    assert double_area(mesh) == 8 * HALF_X * HALF_Y
    assert len(set(mesh.points)) == len(mesh.points)


@pytest.mark.parametrize("half_mm", [1.0, 5.0, 9.5])
def test_refined_triangles_are_short_and_well_shaped(half_mm: float) -> None:
    mesh = with_square(half_mm)
    mesh.refine(longest=3.0 * GRID_PER_MM, shortest=0.2 * GRID_PER_MM)
    lengths = [
        hypot(*(mesh.points[triangle[i]][k] - mesh.points[triangle[i - 1]][k] for k in (0, 1)))
        for triangle in mesh.triangles
        for i in range(3)
    ]
    assert max(lengths) <= 3.0 * GRID_PER_MM
    assert smallest_angle(mesh) > 20.7
    assert double_area(mesh) == 8 * HALF_X * HALF_Y


@pytest.mark.parametrize("x_mm", [0.0, 1.5, 3.7222223, -7.1])
def test_segment_that_ends_on_another_cuts_it_there_and_nowhere_near(x_mm: float) -> None:
    """Halving the rectangle's side until it meets the end would put a cluster of points around it."""
    mesh, x = PlaneMesh(HALF_X, HALF_Y, max_points=200), round(x_mm * GRID_PER_MM)
    mesh.add_segment(*(mesh.add_point((x, y)) for y in (-HALF_Y, HALF_Y)), is_wall=False)
    mesh.refine(longest=4.0 * GRID_PER_MM, shortest=0.25 * GRID_PER_MM)
    assert len(mesh.points) < 100
    at_the_side = sorted(point[0] for point in mesh.points if point[1] == HALF_Y)
    assert x in at_the_side
    assert min(b - a for a, b in pairwise(at_the_side)) > GRID_PER_MM
    assert smallest_angle(mesh) > 20.7


def test_walls_stay_where_they_are() -> None:
    mesh = with_square(4.0)
    mesh.refine(longest=2.0 * GRID_PER_MM, shortest=0.2 * GRID_PER_MM)
    half = 4 * GRID_PER_MM
    on_square = [index for index, (x, y) in enumerate(mesh.points) if max(abs(x), abs(y)) == half]
    assert sorted({corner for wall in mesh.walls for corner in wall}) == on_square
    edges = {tuple(sorted((t[i], t[i - 1]))) for t in mesh.triangles for i in range(3)}
    assert mesh.walls <= edges


def test_order_of_insertion_is_all_that_decides() -> None:
    first, second = with_square(3.3), with_square(3.3)
    for mesh in (first, second):
        mesh.refine(longest=2.5 * GRID_PER_MM, shortest=0.2 * GRID_PER_MM)
    assert (first.points, first.triangles) == (second.points, second.triangles)


def test_more_points_than_allowed_are_refused() -> None:
    with pytest.raises(TooManyPoints, match="More than 20 points"):
        with_square(3.0, max_points=20).refine(longest=1.0 * GRID_PER_MM, shortest=0.2 * GRID_PER_MM)


def test_point_beside_a_segment_halves_it() -> None:
    mesh = with_square(4.0)
    before = len(mesh.points)
    assert mesh.add_near((0, 4 * GRID_PER_MM + 1000), shortest=0.2 * GRID_PER_MM)
    assert mesh.points[before:] == [(0, 4 * GRID_PER_MM)]
    assert mesh.add_near((GRID_PER_MM, GRID_PER_MM), shortest=0.2 * GRID_PER_MM)
    assert mesh.points[-1] == (GRID_PER_MM, GRID_PER_MM)
