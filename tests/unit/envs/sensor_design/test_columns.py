"""Prisms between a base and given heights: volumes are exact, neighbours fit, and walls keep their place."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from vitac.envs.sensor_design.columns import Columns, WallsTangled
from vitac.envs.sensor_design.plane_mesh import Edge, Triangle
from vitac.envs.sensor_design.tetrahedra import Tetrahedra

FloatArray = NDArray[np.float64]

# A square of 2 mm in four triangles around its centre.
POINTS_MM = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [0.0, 0.0]])
FAN: list[Triangle] = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (0, 4, 3)]


def columns(heights_mm: FloatArray, *, walls: set[Edge] | None = None, spacing_mm: float = 100.0) -> Columns:
    return Columns(
        FAN, walls or set(), corners_mm=POINTS_MM[np.array(FAN)], heights_mm=heights_mm, spacing_mm=spacing_mm
    )


def at_points(heights_mm: FloatArray) -> FloatArray:
    """Heights of all triangles from those of the points."""
    return np.asarray(heights_mm[np.array(FAN)])


def mesh(made: Columns) -> Tetrahedra:
    nodes = np.array([(*POINTS_MM[point], height) for point, height in made.nodes()])
    return Tetrahedra(nodes_mm=nodes, corners=np.array(made.tetrahedra()))


def is_closed(made: Tetrahedra) -> bool:
    surface = made.surface
    return (len(surface.open_edges), len(surface.mixed_edges), made.n_shared_faces) == (0, 0, 0)


@settings(max_examples=60)
@given(st.lists(st.floats(0.5, 9.0), min_size=5, max_size=5), st.floats(0.3, 10.0))
def test_volume_is_that_below_the_faces(heights_mm: list[float], spacing_mm: float) -> None:
    heights = at_points(np.array(heights_mm))
    made = mesh(columns(heights, spacing_mm=spacing_mm))
    assert (made.volumes_mm3 > 0.0).all()
    # Every triangle has 1 mm2.
    assert made.volume_mm3 == pytest.approx(heights.mean(axis=1).sum())
    assert is_closed(made)


def test_top_faces_are_those_that_were_asked_for() -> None:
    heights = at_points(np.array([1.0, 2.0, 3.0, 4.0, 5.0]))
    top = columns(heights).top_corners_mm()
    np.testing.assert_array_equal(top[:, :, 2], heights)
    np.testing.assert_array_equal(top[:, :, :2], POINTS_MM[np.array(FAN)])


@pytest.mark.parametrize(("spacing_mm", "pieces"), [(100.0, 1), (4.0, 1), (2.0, 2), (2.5, 2), (1.0, 4)])
def test_nodes_of_a_column_are_evenly_spaced(spacing_mm: float, pieces: int) -> None:
    nodes = columns(at_points(np.full(5, 4.0)), spacing_mm=spacing_mm).nodes()
    assert [height for point, height in nodes if point == 4] == pytest.approx(np.linspace(0.0, 4.0, pieces + 1))
    assert len(nodes) == 5 * (pieces + 1)


def test_heights_that_hardly_differ_become_one_level() -> None:
    heights = at_points(np.full(5, 4.0))
    heights[0, 2] += 0.019
    walls = {(0, 4), (1, 4)}
    assert len(columns(heights, walls=walls).nodes()) == 10
    heights[0, 2] += 0.01
    assert len(columns(heights, walls=walls).nodes()) == 11


def test_without_a_wall_a_jump_is_averaged() -> None:
    heights = at_points(np.full(5, 4.0))
    heights[0, 2] = 6.0
    made = columns(heights)
    assert made.top_corners_mm()[:, :, 2][np.array(FAN) == 4] == pytest.approx(4.5)


def step(low_mm: float, high_mm: float) -> Columns:
    """The square's lower and right triangle at one height, the others at another, walls between them."""
    heights = np.array([[low_mm] * 3, [low_mm] * 3, [high_mm] * 3, [high_mm] * 3])
    return columns(heights, walls={(2, 4), (0, 4)}, spacing_mm=2.0)


@settings(max_examples=40)
@given(st.floats(0.5, 9.0), st.floats(0.5, 9.0))
def test_across_a_wall_heights_jump_and_the_mesh_is_closed(low_mm: float, high_mm: float) -> None:
    made = step(low_mm, high_mm)
    if abs(high_mm - low_mm) > 0.05:
        assert sorted(set(made.top_corners_mm()[:, :, 2].ravel())) == sorted({low_mm, high_mm})
        assert mesh(made).volume_mm3 == pytest.approx(2 * low_mm + 2 * high_mm)
    assert (mesh(made).volumes_mm3 > 0.0).all()
    assert is_closed(mesh(made))


def test_sides_and_step_are_vertical() -> None:
    surface = mesh(step(2.0, 5.0)).surface
    is_vertical = np.abs(surface.area_vectors_mm2[:, 2]) < 1e-12
    sides_mm2, step_mm2 = 2 * 2.0 * 2.0 + 2 * 2.0 * 5.0, 2.0 * np.sqrt(2.0) * 3.0
    assert surface.areas_mm2[is_vertical].sum() == pytest.approx(sides_mm2 + step_mm2)
    assert surface.areas_mm2[~is_vertical].sum() == pytest.approx(4.0 + 4.0)


def test_faces_that_cross_along_a_wall_are_refused() -> None:
    heights = at_points(np.full(5, 4.0))
    heights[0] = [4.0, 3.0, 5.0]
    heights[1] = [5.0, 4.0, 3.0]
    with pytest.raises(WallsTangled, match=r"cross along it; bring a tet\.msh"):
        columns(heights, walls={(1, 4), (0, 4), (2, 4)})
