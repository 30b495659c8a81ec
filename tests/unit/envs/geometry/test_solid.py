"""Solids of flat faces: closed, with the volume of what was drawn, in any direction of extrusion."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from polygon_area import signed_area
from vitac.envs.fem.model.mesh import SurfaceMesh
from vitac.envs.geometry.pegs import PLATE_OUTLINE_MM, PROFILES_MM, PegShape, hole_outline_mm
from vitac.envs.geometry.solid import (
    XY_ALONG_Z,
    ZX_ALONG_Y,
    Face,
    Polygon,
    as_polygon,
    boundaries_touch,
    contains,
    mitred_offset,
    nearest_vertices,
    orientation,
    overlaps_plate,
    prism_faces,
    rectangle,
    segments_touch,
    solid_from_faces,
    triangulate,
)

NOTCHED = as_polygon([(0, 0), (10, 0), (10, 6), (6, 6), (6, 2), (4, 2), (4, 6), (0, 6)])
AXES = [XY_ALONG_Z, ZX_ALONG_Y, (1, 2, 0)]
LENGTHS = st.floats(0.5, 50.0)


def prism(profile: Polygon, axes: tuple[int, int, int] = XY_ALONG_Z, holes: tuple[Polygon, ...] = ()) -> SurfaceMesh:
    return solid_from_faces(prism_faces(profile, -2.0, 3.0, axes=axes, holes_mm=holes), "a prism")


@given(LENGTHS, LENGTHS, LENGTHS)
def test_a_box_has_eight_corners_and_its_volume(x_mm: float, y_mm: float, z_mm: float) -> None:
    box = solid_from_faces(prism_faces(rectangle(0.0, x_mm, 0.0, y_mm), 0.0, z_mm), "a box")
    assert (len(box.vertices_m), len(box.triangles)) == (8, 12)
    assert box.volume_m3 * 1e9 == pytest.approx(x_mm * y_mm * z_mm)
    assert box.vertices_m.max(axis=0) * 1e3 == pytest.approx([x_mm, y_mm, z_mm])


@pytest.mark.parametrize("axes", AXES)
def test_a_prism_has_the_same_volume_in_any_direction(axes: tuple[int, int, int]) -> None:
    solid = prism(NOTCHED, axes)
    assert solid.volume_m3 * 1e9 == pytest.approx(5.0 * signed_area(NOTCHED))
    low, high = solid.vertices_m.min(axis=0) * 1e3, solid.vertices_m.max(axis=0) * 1e3
    assert [low[axis] for axis in axes] == pytest.approx([0.0, 0.0, -2.0])
    assert [high[axis] for axis in axes] == pytest.approx([10.0, 6.0, 3.0])


@pytest.mark.parametrize("axes", AXES)
def test_through_holes_are_open_and_walled(axes: tuple[int, int, int]) -> None:
    holes = (rectangle(1.0, 2.0, 1.0, 3.0), rectangle(5.0, 8.0, 2.0, 4.0))
    solid = prism(rectangle(0.0, 10.0, 0.0, 6.0), axes, holes)
    assert solid.volume_m3 * 1e9 == pytest.approx(5.0 * (60.0 - 2.0 - 6.0))
    assert len(solid.vertices_m) == 2 * (4 + 4 + 4)
    # Euler: a body with two through holes has genus 2, so V - E + F = -2 with E = 3 F / 2.
    assert len(solid.vertices_m) - len(solid.triangles) // 2 == -2


@pytest.mark.parametrize("axes", AXES)
def test_every_edge_has_a_triangle_on_both_sides(axes: tuple[int, int, int]) -> None:
    triangles = prism(NOTCHED, axes).triangles
    edges = [(int(t[i]), int(t[(i + 1) % 3])) for t in triangles for i in range(3)]
    assert len(set(edges)) == len(edges)
    assert {(b, a) for a, b in edges} == set(edges)


def test_corners_at_one_position_become_one_vertex_in_the_order_in_which_they_are_met() -> None:
    first = Face(outline_mm=np.array([[0.0, 0, 0], [0, 1, 0], [1, 0, 0]]))
    sides = [
        Face(outline_mm=np.array([[0.0, 0, 0], [1, 0, 0], [0, 0, 1]])),
        Face(outline_mm=np.array([[0.0, 0, 0], [0, 0, 1], [0, 1, 0]])),
        Face(outline_mm=np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])),
    ]
    corner = solid_from_faces([first, *sides], "a corner of a cube")
    assert (corner.vertices_m * 1e3).tolist() == [[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1]]
    assert corner.volume_m3 * 1e9 == pytest.approx(1.0 / 6.0)
    assert corner.name == "a corner of a cube"


def test_a_rectangle_runs_counter_clockwise() -> None:
    assert rectangle(1.0, 3.0, 5.0, 6.0).tolist() == [[1, 5], [3, 5], [3, 6], [1, 6]]
    assert signed_area(rectangle(-1.0, 3.0, -5.0, 6.0)) == 44.0


def test_the_nearest_vertex_of_each_point_is_found() -> None:
    box = prism(rectangle(0.0, 10.0, 0.0, 6.0))
    for index, vertex in enumerate(box.vertices_m):
        beside = vertex + np.array([1e-3, -1e-3, 5e-4])
        assert nearest_vertices(box, np.array([vertex, beside])).tolist() == [index, index]
    assert nearest_vertices(box, np.empty((0, 3))).tolist() == []


COMB = as_polygon([(0, 0), (9, 0), (9, 1), (8, 1), (8, 2), (7, 2), (7, 1), (5, 1), (5, 2), (4, 2), (4, 1), (0, 1)])


def areas(outline: Polygon, holes: tuple[Polygon, ...], triangles: list[tuple[int, int, int]]) -> list[float]:
    points = np.concatenate([outline, *holes])
    return [0.5 * orientation(points[a], points[b], points[c]) for a, b, c in triangles]


@pytest.mark.parametrize("outline", [*PROFILES_MM.values(), COMB, rectangle(0, 1, 0, 2)])
def test_triangles_of_a_simple_polygon_cover_it_once(outline: Polygon) -> None:
    triangles = triangulate(outline)
    assert len(triangles) == len(outline) - 2
    assert min(areas(outline, (), triangles)) > 0
    assert sum(areas(outline, (), triangles)) == pytest.approx(signed_area(outline))


@pytest.mark.parametrize("shape", PegShape)
@pytest.mark.parametrize("turn", [1, -1])
def test_triangles_of_a_plate_leave_the_hole_open(shape: PegShape, turn: int) -> None:
    hole = hole_outline_mm(shape)
    triangles = triangulate(PLATE_OUTLINE_MM, (hole[::turn],))
    assert len(triangles) == 4 + len(hole)
    assert min(areas(PLATE_OUTLINE_MM, (hole[::turn],), triangles)) > 0
    assert sum(areas(PLATE_OUTLINE_MM, (hole[::turn],), triangles)) == pytest.approx(3500.0 - signed_area(hole))


def test_several_holes_in_a_row_are_left_open() -> None:
    outline = rectangle(0, 62, -20, 20)
    holes = tuple(rectangle(low, low + 8, -4, 4) for low in (15, 31, 47))
    triangles = triangulate(outline, holes)
    assert min(areas(outline, holes, triangles)) > 0
    assert sum(areas(outline, holes, triangles)) == pytest.approx(62 * 40 - 3 * 64)


def test_no_triangle_edge_passes_through_a_corner() -> None:
    for a, b, c in triangulate(COMB):
        for i, j in ((a, b), (b, c), (c, a)):
            for other in set(range(len(COMB))) - {i, j}:
                on_line = orientation(COMB[i], COMB[j], COMB[other]) == 0
                along = (COMB[other] - COMB[i]) @ (COMB[j] - COMB[i]) / ((COMB[j] - COMB[i]) ** 2).sum()
                assert not (on_line and 0 < along < 1)


SQUARE = rectangle(-1.0, 1.0, -1.0, 1.0)


def test_area_is_positive_counter_clockwise_and_negative_clockwise() -> None:
    assert signed_area(SQUARE) == 4.0
    assert signed_area(SQUARE[::-1]) == -4.0


@given(st.floats(0.01, 5.0))
def test_offset_of_a_rectangle_widens_each_side_by_the_distance(distance: float) -> None:
    assert mitred_offset(SQUARE, distance) == pytest.approx(SQUARE * (1.0 + distance))


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
