import drawn_gels
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from vitac.envs.sensor_design.sampling import pulled_corners, samples_mm
from vitac.envs.sensor_design.surface import DrawnSurface

FloatArray = NDArray[np.float64]
RIGHT_ANGLED = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]])


def of(*triangles: FloatArray) -> DrawnSurface:
    return DrawnSurface.of_corners(np.array(triangles))


def test_samples_hold_every_corner() -> None:
    surface = drawn_gels.pyramids()
    found = {tuple(point) for point in samples_mm(surface).round(9).tolist()}
    assert {tuple(corner) for corner in surface.corners_mm.reshape(-1, 3).round(9).tolist()} <= found


def test_no_point_of_a_triangle_is_far_from_a_sample() -> None:
    random = np.random.default_rng(0)
    weights = random.dirichlet((1.0, 1.0, 1.0), 300)
    points = weights @ RIGHT_ANGLED
    apart = np.linalg.norm(points[:, None] - samples_mm(of(RIGHT_ANGLED))[None], axis=2)
    assert apart.min(axis=1).max() < 0.5


def test_samples_lie_on_their_triangle() -> None:
    x, y, z = samples_mm(of(RIGHT_ANGLED)).T
    assert (z == 0.0).all()
    assert min(x.min(), y.min()) >= 0.0
    assert (x / 3.0 + y / 4.0).max() <= 1.0 + 1e-12


def test_number_of_samples_follows_from_the_longest_side() -> None:
    # 5 mm in pieces of 0.5 mm: 10 cuts, 11 * 12 / 2 points.
    assert len(samples_mm(of(RIGHT_ANGLED))) == 66
    assert len(samples_mm(of(0.01 * RIGHT_ANGLED))) == 3
    assert len(samples_mm(of(RIGHT_ANGLED, 0.01 * RIGHT_ANGLED + 9.0))) == 69


def test_a_huge_triangle_has_a_bounded_number_of_samples() -> None:
    assert len(samples_mm(of(100.0 * RIGHT_ANGLED))) == 65 * 66 // 2


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
