from functools import partial

import drawn_gels
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from vitac.envs.sensor_design.crossings import NONE, TOO_MANY, farthest, first_crossing
from vitac.envs.sensor_design.surface import (
    MAX_SAMPLES,
    DrawnSurface,
    pulled_corners,
    samples_mm,
    samples_of_triangles_mm,
)

SOUND = {"flat": drawn_gels.flat, "ridge": drawn_gels.ridge, "pyramids": drawn_gels.pyramids, "dome": drawn_gels.dome}


def crossing(surface: DrawnSurface, max_pairs: int = 10**6) -> tuple[int, int]:
    return first_crossing(surface.vertices_mm, surface.triangles, max_pairs)


@pytest.mark.parametrize("name", SOUND)
def test_sound_surface_has_none(name: str) -> None:
    assert crossing(SOUND[name]()) == (NONE, NONE)


def test_bodies_that_run_into_each_other_are_found() -> None:
    small = drawn_gels.moved(drawn_gels.flat(2.0), scale=0.5, by=(1.3, 0.7, 3.5))
    surface = drawn_gels.together(drawn_gels.flat(), small)
    first, second = crossing(surface)
    assert 0 <= first < second < len(surface.triangles)
    assert surface.shells[first] != surface.shells[second]


def test_vertex_pulled_through_the_opposite_face_is_found() -> None:
    surface = drawn_gels.pyramids()
    surface.vertices_mm[surface.vertices_mm[:, 2].argmax(), 2] = -1.0
    assert crossing(surface) != (NONE, NONE)


def test_top_that_dips_through_a_base_on_the_same_grid_is_found() -> None:
    """Its edges lie exactly above those of the base, so that none goes through the inside of a triangle."""
    dip = drawn_gels.smooth(lambda x, y: -2.0 if abs(x) + abs(y) < 5.0 else 4.0, 6)
    assert crossing(dip) != (NONE, NONE)


@pytest.mark.parametrize(("height", "crosses"), [(0.0, True), (1e-9, False)])
def test_edge_that_ends_on_a_triangle_meets_it_and_one_that_ends_above_does_not(height: float, crosses: bool) -> None:
    vertices = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0], [0.5, 0.0, height], [0.5, 0.5, 3], [0.6, -0.5, 3]])
    assert (first_crossing(vertices, np.array([[0, 1, 2], [3, 4, 5]]), 10) == (0, 1)) is crosses


def test_triangles_of_one_leaning_plane_do_not_cross() -> None:
    for slope in (0.1, 0.3, 1.7):
        leaning = drawn_gels.smooth(partial(plane, slope), 9)
        assert crossing(leaning) == (NONE, NONE)


def plane(slope: float, x: float, y: float) -> float:
    return 30.0 + slope * x + y / 3.0


def test_triangle_folded_onto_its_neighbour_is_found() -> None:
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.1, 0.5, 0]])
    assert first_crossing(vertices, np.array([[0, 1, 2], [1, 0, 3]]), 10) == (0, 1)


def test_too_many_near_pairs_are_not_looked_at() -> None:
    assert crossing(drawn_gels.dome(), max_pairs=10) == (TOO_MANY, TOO_MANY)


def test_farthest_point_and_its_distance() -> None:
    surface = drawn_gels.flat()
    points = np.array([[0.0, 0.0, 4.5], [0.0, 0.0, 2.0], [15.0, 0.0, 1.0]])
    point, distance = farthest(points, surface.vertices_mm, surface.triangles)
    assert point == 2
    assert distance == pytest.approx(15.0 - 12.625)


def test_points_of_a_surface_are_on_it() -> None:
    surface = drawn_gels.wedge()
    assert farthest(surface.vertices_mm, surface.vertices_mm, surface.triangles)[1] < 1e-12


FloatArray = NDArray[np.float64]
RIGHT_ANGLED = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]])


def of(*triangles: FloatArray) -> FloatArray:
    return np.array(triangles)


def slivers(count: int) -> FloatArray:
    """Return triangles of 25 mm length and 1 um height, one above the other."""
    low = np.arange(count) * 1e-3
    first = np.column_stack([np.zeros(count), low, np.zeros(count)])
    return np.stack([first, first + np.array([25.0, 0.0, 0.0]), first + np.array([12.5, 1e-3, 0.0])], axis=1)


def test_samples_hold_every_corner() -> None:
    surface = drawn_gels.pyramids()
    found = {tuple(point) for point in surface.samples_mm.tolist()}
    assert {tuple(corner) for corner in surface.vertices_mm.tolist()} <= found


def test_samples_are_computed_once() -> None:
    surface = drawn_gels.flat()
    assert surface.samples_mm is surface.samples_mm


@pytest.mark.parametrize("turn", [0, 1, 2])
def test_no_point_of_a_triangle_is_far_from_a_sample(turn: int) -> None:
    random = np.random.default_rng(0)
    weights = random.dirichlet((1.0, 1.0, 1.0), 300)
    points = weights @ RIGHT_ANGLED
    apart = np.linalg.norm(points[:, None] - samples_mm(of(np.roll(RIGHT_ANGLED, turn, axis=0)))[None], axis=2)
    assert apart.min(axis=1).max() < 0.5


def test_samples_lie_on_their_triangle() -> None:
    x, y, z = samples_mm(of(RIGHT_ANGLED)).T
    assert (z == 0.0).all()
    assert min(x.min(), y.min()) >= -1e-12
    assert (x / 3.0 + y / 4.0).max() <= 1.0 + 1e-12


def test_number_of_samples_follows_from_length_and_height() -> None:
    # 5 mm long and 2.4 mm high in pieces of 0.5 mm: rows of 10, 8, 6, 4, 2 and 0 pieces.
    assert len(samples_mm(of(RIGHT_ANGLED))) == 36
    assert len(samples_mm(of(0.01 * RIGHT_ANGLED))) == 3
    assert len(samples_mm(of(RIGHT_ANGLED, 0.01 * RIGHT_ANGLED + 9.0))) == 39


def test_a_sliver_has_samples_along_its_length_only() -> None:
    assert len(samples_mm(slivers(1))) == 50 + 1 + 1


def test_a_huge_triangle_has_a_bounded_number_of_samples() -> None:
    assert len(samples_mm(of(1000.0 * RIGHT_ANGLED))) == sum(range(1, 66))


def test_samples_of_the_worst_surface_are_bounded_and_hold_every_corner() -> None:
    corners = slivers(20_000)
    samples = samples_mm(corners)
    assert len(samples) <= MAX_SAMPLES
    assert set(map(tuple, corners.reshape(-1, 3).tolist())) <= set(map(tuple, samples.tolist()))


def test_more_triangles_than_samples_are_kept_to_their_corners() -> None:
    assert len(samples_mm(slivers(MAX_SAMPLES // 2))) == 3 * (MAX_SAMPLES // 2)


@given(st.integers(0, 10**6), st.floats(1e-3, 10.0))
def test_corners_are_pulled_inside_by_the_distance_or_to_the_middle(seed: int, distance: float) -> None:
    corners = np.random.default_rng(seed).normal(size=(5, 3, 2))
    middle = corners.mean(axis=1, keepdims=True)
    pulled = pulled_corners(corners, distance)
    moved = np.linalg.norm(pulled - corners, axis=2)
    assert moved == pytest.approx(np.minimum(distance, np.linalg.norm(middle - corners, axis=2)), abs=1e-12)
    left = np.linalg.norm(middle - pulled, axis=2) + moved
    assert left == pytest.approx(np.linalg.norm(middle - corners, axis=2), abs=1e-12)


def test_a_triangle_without_extent_stays_where_it_is() -> None:
    assert pulled_corners(np.ones((1, 3, 3)), 0.1).tolist() == np.ones((1, 3, 3)).tolist()


def test_each_sample_is_of_the_triangle_that_is_named() -> None:
    corners = drawn_gels.wedge().corners_mm
    points, faces = samples_of_triangles_mm(corners)
    assert set(faces.tolist()) == set(range(len(corners)))
    for point, face in zip(points, faces.tolist(), strict=True):
        assert farthest(point[None], corners[face], np.array([[0, 1, 2]]))[1] < 1e-9
