"""Bodies that overlap are found wherever they cross, and bodies that do not overlap are left alone."""

import numpy as np
import pytest
from block_meshes import box_gel, box_surface
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from small_scenes import IDENTITY
from vectors import random_rotation, vec3
from vitac.envs.fem.contact.overlap import segment_crosses_triangle
from vitac.envs.fem.model.mesh import GelBody, RigidBody
from vitac.envs.fem.scene.layout import SceneError
from vitac.envs.fem.scene.scene import Scene

FloatArray = NDArray[np.float64]
TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
some = settings(max_examples=60)


def crosses(p: FloatArray, q: FloatArray, triangle: FloatArray = TRIANGLE) -> bool:
    a, b, c = triangle
    return bool(segment_crosses_triangle(vec3(p), vec3(q), vec3(a), vec3(b), vec3(c)))


def upright(x: float, y: float, low: float = -1.0, high: float = 1.0) -> tuple[FloatArray, FloatArray]:
    return np.array([x, y, low]), np.array([x, y, high])


@some
@given(st.floats(-1.0, 2.0), st.floats(-1.0, 2.0))
def test_an_upright_segment_crosses_where_it_stands_on_the_triangle(x: float, y: float) -> None:
    inside = min(x, y, 1.0 - x - y)
    if abs(inside) > 1e-9:
        assert crosses(*upright(x, y)) is (inside > 0.0)


@pytest.mark.parametrize(("low", "high"), [(0.1, 1.0), (-1.0, -0.1), (1e-12, 1.0)])
def test_a_segment_that_ends_before_the_plane_does_not_cross(low: float, high: float) -> None:
    assert not crosses(*upright(0.2, 0.3, low, high))
    assert crosses(*upright(0.2, 0.3, -high, high))


def test_a_segment_in_the_plane_does_not_cross() -> None:
    assert not crosses(np.array([-1.0, 0.3, 0.0]), np.array([2.0, 0.3, 0.0]))


@some
@given(st.integers(0, 10**6))
def test_crossing_does_not_depend_on_directions_or_place(seed: int) -> None:
    random = np.random.default_rng(seed)
    p, q = random.normal(size=(2, 3))
    triangle = random.normal(size=(3, 3))
    expected = crosses(p, q, triangle)
    assert crosses(q, p, triangle) is expected
    for order in ([1, 2, 0], [2, 1, 0], [0, 2, 1]):
        assert crosses(p, q, triangle[order]) is expected
    rotation, shift = random_rotation(random), random.normal(size=3)
    moved = triangle @ rotation.T + shift
    assert crosses(p @ rotation.T + shift, q @ rotation.T + shift, moved) is expected


@some
@given(st.integers(0, 10**6))
def test_crossing_agrees_with_solving_for_the_point(seed: int) -> None:
    random = np.random.default_rng(seed)
    p, q = random.normal(size=(2, 3))
    a, b, c = random.normal(size=(3, 3))
    t, v, w = np.linalg.solve(np.column_stack([p - q, b - a, c - a]), p - a)
    margin = min(t, 1.0 - t, v, w, 1.0 - v - w)
    if abs(margin) > 1e-6:
        assert crosses(p, q, np.array([a, b, c])) is bool(margin > 0.0)


def scene(size_m: tuple[float, float, float], low_m: tuple[float, float, float]) -> Scene:
    """A gel of 6 x 5 x 4 mm, its lowest corner at the origin, and a box."""
    gel = GelBody(mesh=box_gel((0.006, 0.005, 0.004), (1, 1, 1)), rotation=IDENTITY, translation_m=np.zeros(3))
    box = RigidBody(mesh=box_surface(size_m), rotation=IDENTITY, translation_m=np.array(low_m))
    return Scene(gels=[gel], bodies=[box], time_step_s=0.1)


@pytest.mark.parametrize(
    ("size_m", "low_m"),
    [
        pytest.param((0.0002, 0.0002, 0.02), (0.0011, 0.0023, -0.008), id="a rod through the gel"),
        pytest.param((0.02, 0.02, 0.0002), (-0.008, -0.008, 0.0021), id="a plate through which the gel reaches"),
        pytest.param((0.02, 0.02, 0.02), (-0.008, -0.008, -0.008), id="a box around the gel"),
        pytest.param((0.001, 0.001, 0.001), (0.0021, 0.0023, 0.0017), id="a box within the gel"),
        pytest.param((0.001, 0.001, 0.001), (0.0055, 0.0045, 0.0035), id="a corner in a corner"),
    ],
)
def test_a_scene_whose_bodies_overlap_is_refused(
    size_m: tuple[float, float, float], low_m: tuple[float, float, float]
) -> None:
    with pytest.raises(SceneError, match=r"block \(body 0\) and box \(body 1\) overlap at the start"):
        scene(size_m, low_m)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("gap_m", [1e-6, 1e-4, 1e-2])
def test_a_scene_with_a_gap_between_its_bodies_is_accepted(axis: int, gap_m: float) -> None:
    low_m = np.zeros(3)
    low_m[axis] = (0.006, 0.005, 0.004)[axis] + gap_m
    x, y, z = low_m.tolist()
    scene((0.003, 0.003, 0.003), (x, y, z))
