from collections.abc import Callable
from itertools import pairwise

import drawn_gels
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.envs.sensor_design.crossings import NONE, first_crossing
from vitac.envs.sensor_design.surface import DrawnSurface, placed_on_base


def without(surface: DrawnSurface, triangle: int) -> DrawnSurface:
    return DrawnSurface(vertices_mm=surface.vertices_mm, triangles=np.delete(surface.triangles, triangle, axis=0))


def test_sample_of_the_challenge_has_its_volume_and_no_fault() -> None:
    surface = drawn_gels.bevelled()
    assert surface.volume_mm3 == pytest.approx(2051.0833, abs=1e-4)
    assert (len(surface.open_edges), len(surface.mixed_edges), len(surface.branching_edges)) == (0, 0, 0)
    assert surface.extent_mm == pytest.approx([25.25, 20.75, 4.0])
    assert len(surface.edges) == 30


def test_volume_does_not_depend_on_the_place() -> None:
    surface = drawn_gels.moved(drawn_gels.dome(), by=(1e4, -3e4, 2e4))
    assert surface.volume_mm3 == pytest.approx(drawn_gels.dome().volume_mm3, rel=1e-7)


def test_missing_triangle_opens_three_edges() -> None:
    assert len(without(drawn_gels.flat(), 0).open_edges) == 3


def test_turned_triangle_disagrees_at_three_edges() -> None:
    surface = drawn_gels.flat()
    surface.triangles[0] = surface.triangles[0][::-1]
    assert len(surface.mixed_edges) == 3


def test_third_triangle_at_an_edge_is_counted() -> None:
    surface = drawn_gels.flat()
    fin = np.array([[surface.triangles[0, 0], surface.triangles[0, 1], len(surface.vertices_mm)]])
    vertices = np.concatenate([surface.vertices_mm, [[0.0, 0.0, 30.0]]])
    branching = DrawnSurface(vertices_mm=vertices, triangles=np.concatenate([surface.triangles, fin]))
    assert (len(branching.branching_edges), len(branching.open_edges)) == (1, 2)


def test_shells_are_told_apart() -> None:
    two = drawn_gels.together(drawn_gels.flat(), drawn_gels.moved(drawn_gels.flat(2.0), by=(0, 0, 10)))
    assert len(np.unique(two.shells)) == 2
    assert sorted(two.shell_volumes_mm3()) == pytest.approx([1047.875, 2095.75])
    assert len(drawn_gels.dome(cells=30).shells) == len(drawn_gels.dome(cells=30).triangles)
    assert (drawn_gels.dome(cells=30).shells == 0).all()


def test_edges_know_their_two_triangles() -> None:
    surface = drawn_gels.pyramids()
    for edge, pair in zip(surface.edges, surface.triangles_of_edges, strict=True):
        for triangle in pair:
            assert set(edge) <= set(surface.triangles[triangle])


def test_triangles_without_area_from_equal_corners_are_left_away() -> None:
    corners = np.concatenate([drawn_gels.flat().corners_mm, np.zeros((1, 3, 3))])
    assert len(DrawnSurface.from_corners(corners).triangles) == 12


def test_a_point_of_a_triangle_without_area_does_not_count_towards_the_extent() -> None:
    corners = DrawnSurface.from_corners(np.eye(3)[np.newaxis]).corners_mm
    stray = np.array([[[0.0, 0.0, 9.0], [0.0, 0.0, 9.0], [1.0, 0.0, 0.0]]])
    surface = DrawnSurface.from_corners(np.concatenate([corners, stray]))
    assert surface.vertices_mm.max() == 1.0
    assert np.array_equal(surface.corners_mm, corners)


def with_t_junctions(surface: DrawnSurface, parts: int) -> np.ndarray:
    """The corners of a surface one of whose edges has further vertices on one side, closed as CAD kernels do it."""
    a, b = surface.edges[0]
    divided = next(n for n, t in enumerate(surface.triangles) if (a, b) in [(t[i], t[(i + 1) % 3]) for i in range(3)])
    start, end = surface.vertices_mm[[a, b]]
    third = surface.vertices_mm[next(v for v in surface.triangles[divided] if v not in (a, b))]
    points = [start + (end - start) * part / parts for part in range(parts + 1)]
    fan = [[p, q, third] for p, q in pairwise(points)]
    closing = [[points[part + 1], points[part], end] for part in range(parts - 1)]
    return np.concatenate([np.delete(surface.corners_mm, divided, axis=0), fan, closing]).astype(np.float32)


@pytest.mark.parametrize("parts", [2, 3, 7])
@pytest.mark.parametrize("gel", [drawn_gels.flat, drawn_gels.dome, drawn_gels.pyramids])
def test_t_junctions_that_are_closed_by_triangles_without_height_are_divided(
    gel: Callable[[], DrawnSurface], parts: int
) -> None:
    plain = gel()
    surface = DrawnSurface.from_corners(with_t_junctions(plain, parts).astype(np.float64))
    assert (len(surface.open_edges), len(surface.mixed_edges), len(surface.branching_edges)) == (0, 0, 0)
    assert surface.areas_mm2.min() > 1e-6
    assert len(surface.triangles) == len(plain.triangles) + 2 * (parts - 1)
    assert surface.volume_mm3 == pytest.approx(plain.volume_mm3, rel=1e-6)
    assert first_crossing(surface.vertices_mm, surface.triangles, 10**6) == (NONE, NONE)


offsets = st.floats(-1000.0, 1000.0)


@given(st.tuples(offsets, offsets, offsets))
def test_the_place_of_a_drawing_does_not_matter(by: tuple[float, float, float]) -> None:
    drawn = drawn_gels.wedge()
    placed = placed_on_base(drawn_gels.moved(drawn, by=by), length_mm=25.25, width_mm=20.75)
    expected = placed_on_base(drawn, length_mm=25.25, width_mm=20.75)
    np.testing.assert_allclose(placed.vertices_mm, expected.vertices_mm, atol=1e-9)
    np.testing.assert_array_equal(placed.triangles, drawn.triangles)


def test_base_is_centred_at_height_zero() -> None:
    placed = placed_on_base(drawn_gels.moved(drawn_gels.ridge(), by=(3.0, 2.0, 1.0)), length_mm=25.25, width_mm=20.75)
    low, high = placed.vertices_mm.min(axis=0), placed.vertices_mm.max(axis=0)
    assert low == pytest.approx([-12.625, -10.375, 0.0], abs=1e-12)
    assert high == pytest.approx([12.625, 10.375, 4.0], abs=1e-12)


def test_heights_are_not_stretched_with_the_base() -> None:
    drawn = drawn_gels.stretched(drawn_gels.dome(cells=6), (1.01, 0.99, 1.0))
    placed = placed_on_base(drawn, length_mm=25.25, width_mm=20.75)
    assert placed.extent_mm == pytest.approx([25.25, 20.75, drawn.extent_mm[2]])
    assert placed.volume_mm3 == pytest.approx(drawn.volume_mm3 / (1.01 * 0.99))


def test_placing_twice_changes_nothing_more() -> None:
    once = placed_on_base(drawn_gels.pyramids(), length_mm=25.25, width_mm=20.75)
    twice = placed_on_base(once, length_mm=25.25, width_mm=20.75)
    np.testing.assert_allclose(twice.vertices_mm, once.vertices_mm, atol=1e-12)
