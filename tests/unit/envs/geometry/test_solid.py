"""Solids of flat faces: closed, with the volume of what was drawn, in any direction of extrusion."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from polygon_area import signed_area
from vitac.envs.fem.model.mesh import SurfaceMesh
from vitac.envs.geometry.polygon import Polygon, as_polygon
from vitac.envs.geometry.solid import (
    XY_ALONG_Z,
    ZX_ALONG_Y,
    Face,
    nearest_vertices,
    prism_faces,
    rectangle,
    solid_from_faces,
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
