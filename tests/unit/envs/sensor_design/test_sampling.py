import drawn_gels
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from vitac.envs.sensor_design.crossings import farthest
from vitac.envs.sensor_design.sampling import MAX_SAMPLES, pulled_corners, samples_mm, samples_of_triangles_mm

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
