"""Closest points of primitive pairs and the derivatives of their distance, in every region."""

import numpy as np
import pytest
from numpy.typing import NDArray
from vectors import differences, vec3
from vitac.envs.fem.contact.contact import SlidingDirection, sliding_directions
from vitac.envs.fem.contact.distance import EDGE_EDGE, POINT_TRIANGLE, Coefficients, Sliding, closest_points

FloatArray = NDArray[np.float64]
TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.05], [0.2, 0.9, -0.1]])
EDGE = np.array([[0.0, 0.0, 0.0], [1.0, 0.1, 0.05]])
# A point over the inside, beyond each edge and beyond each corner; number of sliding directions.
POINTS = {
    "inside": ((0.4, 0.3, 0.5), 2),
    "edge 01": ((0.5, -0.4, 0.3), 1),
    "edge 02": ((-0.5, 0.4, 0.3), 1),
    "edge 12": ((0.9, 0.9, 0.3), 1),
    "corner 0": ((-0.4, -0.3, 0.3), 0),
    "corner 1": ((1.6, 0.0, 0.3), 0),
    "corner 2": ((0.1, 1.5, 0.3), 0),
}
OTHER_EDGES = {
    "crossing": (((0.5, -0.5, 0.4), (0.45, 0.6, 0.5)), 2),
    "end a0": (((-0.5, -0.5, 0.4), (-0.45, 0.6, 0.5)), 1),
    "end a1": (((1.5, -0.5, 0.4), (1.45, 0.6, 0.5)), 1),
    "end b0": (((0.5, 0.3, 0.4), (0.45, 0.9, 0.5)), 1),
    "end b1": (((0.5, 0.9, 0.4), (0.45, 0.3, 0.45)), 1),
    "a0 b0": (((-0.3, 0.2, 0.4), (-0.8, 0.9, 0.9)), 0),
    "a0 b1": (((-0.8, 0.9, 0.9), (-0.3, 0.2, 0.4)), 0),
    "a1 b0": (((1.4, 0.2, 0.4), (1.9, 0.9, 0.9)), 0),
    "a1 b1": (((1.9, 0.9, 0.9), (1.4, 0.2, 0.4)), 0),
}
CASES = [
    pytest.param(POINT_TRIANGLE, np.concatenate([[p], TRIANGLE]), count, id=name) for name, (p, count) in POINTS.items()
] + [
    pytest.param(EDGE_EDGE, np.concatenate([EDGE, other]), count, id=name)
    for name, (other, count) in OTHER_EDGES.items()
]
regions = pytest.mark.parametrize(("pair_type", "x", "slides"), CASES)


def closest(pair_type: int, x: FloatArray) -> tuple[Coefficients, Sliding, FloatArray]:
    c, sliding, r = closest_points(pair_type, vec3(x[0]), vec3(x[1]), vec3(x[2]), vec3(x[3]))
    return c, sliding, np.array(r)


def distance(pair_type: int, x: FloatArray) -> float:
    return float(np.linalg.norm(closest(pair_type, x)[2]))


def gradient(pair_type: int, x: FloatArray) -> FloatArray:
    c, _, r = closest(pair_type, x)
    return np.outer(c, r / np.linalg.norm(r))


def directions(pair_type: int, x: FloatArray) -> list[SlidingDirection]:
    _, sliding, _ = closest(pair_type, x)
    points = (vec3(x[0]), vec3(x[1]), vec3(x[2]), vec3(x[3]))
    return [k for k in sliding_directions(sliding, points, points) if any(k.tangent)]


def hessian(pair_type: int, x: FloatArray) -> FloatArray:
    """The formula of the module, written with dense arrays."""
    c, _, r = closest(pair_type, x)
    coefficients, d = np.array(c), float(np.linalg.norm(r))
    n = r / d
    result = np.zeros((12, 12))
    result += np.kron(np.outer(coefficients, coefficients), (np.eye(3) - np.outer(n, n)) / d)
    for k in directions(pair_type, x):
        m = np.kron(k.dc, n) + np.kron(coefficients, k.tangent) / d
        result -= d * np.outer(m, m)
    return result


@regions
def test_distance_gradient_matches_differences(pair_type: int, x: FloatArray, slides: int) -> None:
    np.testing.assert_allclose(
        gradient(pair_type, x), differences(lambda y: distance(pair_type, y), x, 1e-4), atol=1e-10
    )


@regions
def test_distance_hessian_matches_differences(pair_type: int, x: FloatArray, slides: int) -> None:
    expected = differences(lambda y: gradient(pair_type, y).ravel(), x, 1e-4).reshape(12, 12)
    np.testing.assert_allclose(hessian(pair_type, x), expected, atol=1e-8)


@regions
def test_each_region_has_its_sliding_directions(pair_type: int, x: FloatArray, slides: int) -> None:
    found = directions(pair_type, x)
    assert len(found) == slides
    n = closest(pair_type, x)[2]
    for k in found:
        assert sum(k.dc) == pytest.approx(0, abs=1e-12)
        assert np.linalg.norm(k.tangent) == pytest.approx(1)
        assert np.dot(k.tangent, n) == pytest.approx(0, abs=1e-12)
    if slides == 2:
        assert np.dot(found[0].tangent, found[1].tangent) == pytest.approx(0, abs=1e-12)


@regions
def test_coefficients_sum_to_zero_and_lie_on_the_primitives(pair_type: int, x: FloatArray, slides: int) -> None:
    c, _, _ = closest(pair_type, x)
    assert sum(c) == pytest.approx(0, abs=1e-15)
    split = 1 if pair_type == POINT_TRIANGLE else 2
    assert all(0 <= value <= 1 for value in c[:split])
    assert all(-1 <= value <= 0 for value in c[split:])


def brute_force_distance(pair_type: int, x: FloatArray) -> float:
    """Smallest distance over a fine grid of points on both primitives."""
    s = np.linspace(0, 1, 101)
    if pair_type == EDGE_EDGE:
        a = x[0] + s[:, None] * (x[1] - x[0])
        b = x[2] + s[:, None] * (x[3] - x[2])
        return float(np.linalg.norm(a[:, None] - b[None], axis=2).min())
    u, v = np.meshgrid(s, s)
    inside = u + v <= 1
    on = x[1] + u[inside][:, None] * (x[2] - x[1]) + v[inside][:, None] * (x[3] - x[1])
    return float(np.linalg.norm(x[0] - on, axis=1).min())


@pytest.mark.parametrize("pair_type", [POINT_TRIANGLE, EDGE_EDGE])
def test_random_pairs_are_as_close_as_a_brute_force_search_finds(pair_type: int) -> None:
    random = np.random.default_rng(pair_type)
    for _ in range(60):
        x = random.normal(size=(4, 3))
        found = brute_force_distance(pair_type, x)
        assert distance(pair_type, x) <= found + 1e-12
        assert distance(pair_type, x) >= found - 0.06


@pytest.mark.parametrize("pair_type", [POINT_TRIANGLE, EDGE_EDGE])
def test_random_and_flat_pairs_agree_with_the_ipc_toolkit(pair_type: int) -> None:
    ipctk = pytest.importorskip("ipctk", reason="the IPC Toolkit has no wheel for this machine")
    oracle = ipctk.point_triangle_distance if pair_type == POINT_TRIANGLE else ipctk.edge_edge_distance
    random = np.random.default_rng(10 + pair_type)
    for case in range(2000):
        x = random.normal(size=(4, 3)) * (1.0, 1.0, 1.0 if case % 2 else 1e-3)
        if case % 5 == 0:
            x = np.round(x, 1) + (np.arange(4)[:, None] == 0) * 0.05  # many ties between regions
        if pair_type == POINT_TRIANGLE and np.linalg.norm(np.cross(x[2] - x[1], x[3] - x[1])) < 1e-6:
            continue  # meshes with a degenerate triangle are refused
        if pair_type == EDGE_EDGE and min(np.linalg.norm(x[1] - x[0]), np.linalg.norm(x[3] - x[2])) < 1e-6:
            continue
        assert distance(pair_type, x) ** 2 == pytest.approx(oracle(*x), rel=1e-9, abs=1e-14)


@pytest.mark.parametrize("shift", [0.0, 0.5, 1.0, 2.5, -0.5, -3.0])
def test_parallel_edges_have_the_right_distance(shift: float) -> None:
    x = np.array([[0.0, 0, 0], [1, 0, 0], [shift, 0.3, 0], [shift + 1, 0.3, 0]])
    apart = max(0.0, shift - 1.0, -shift - 1.0)
    assert distance(EDGE_EDGE, x) == pytest.approx(np.hypot(0.3, apart))
    assert distance(EDGE_EDGE, x[[0, 1, 3, 2]]) == pytest.approx(np.hypot(0.3, apart))


def test_nearly_parallel_edges_are_still_exact() -> None:
    ipctk = pytest.importorskip("ipctk", reason="the IPC Toolkit has no wheel for this machine")
    random = np.random.default_rng(0)
    for exponent in range(1, 12):
        x = np.array([[0.0, 0, 0], [1, 0, 0], [0.2, 0.3, 0.1], [1.1, 0.3, 0.1]])
        x += 10.0**-exponent * random.normal(size=(4, 3))
        assert distance(EDGE_EDGE, x) ** 2 == pytest.approx(ipctk.edge_edge_distance(*x), rel=1e-6)


def test_a_point_exactly_over_an_edge_or_corner_is_no_special_case() -> None:
    for weights in ((0.5, 0.5, 0.0), (0.0, 0.5, 0.5), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)):
        normal = np.cross(TRIANGLE[1] - TRIANGLE[0], TRIANGLE[2] - TRIANGLE[0])
        point = np.array(weights) @ TRIANGLE + 0.2 * normal / np.linalg.norm(normal)
        x = np.concatenate([[point], TRIANGLE])
        assert distance(POINT_TRIANGLE, x) == pytest.approx(0.2)
        np.testing.assert_allclose(gradient(POINT_TRIANGLE, x)[0], normal / np.linalg.norm(normal), atol=1e-12)
