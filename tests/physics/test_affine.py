"""Mass, weights and orthogonality of affine bodies."""

import numpy as np
import pytest
from block_meshes import box_surface
from numpy.typing import NDArray
from vectors import columns3, differences, random_rotation
from vitac.envs.fem.affine import (
    affine_columns,
    frame_mass,
    frame_weights,
    orthogonality_block,
    orthogonality_energy,
    orthogonality_error,
    orthogonality_gradient,
)
from vitac.envs.geometry.pegs import PegShape, peg_surface

FloatArray = NDArray[np.float64]


def energy(A: FloatArray) -> float:
    return orthogonality_energy(orthogonality_error(columns3(A)))


def gradient(A: FloatArray) -> FloatArray:
    E = orthogonality_error(columns3(A))
    return np.array([orthogonality_gradient(E, column) for column in columns3(A)]).T


def hessian(A: FloatArray, *, projected: bool) -> FloatArray:
    """Second derivative with unknowns ordered column by column, shape [9, 9]."""
    E, a = orthogonality_error(columns3(A)), columns3(A)
    rows = [[orthogonality_block(E, a[k], a[m], k == m, projected) for m in range(3)] for k in range(3)]
    return np.block([[np.array(block) for block in row] for row in rows])


def by_columns(derivative: FloatArray) -> FloatArray:
    """Derivative [3, 3 (of gradient), 3, 3 (of A)] in the order of `hessian`."""
    return derivative.transpose(1, 0, 3, 2).reshape(9, 9)


@pytest.mark.parametrize("seed", range(4))
def test_orthogonality_derivatives_match_differences(seed: int) -> None:
    A = random_rotation(np.random.default_rng(seed)) + 0.1 * np.random.default_rng(seed + 9).normal(size=(3, 3))
    assert energy(A) == pytest.approx(np.linalg.norm(A @ A.T - np.eye(3)) ** 2)
    np.testing.assert_allclose(gradient(A), differences(energy, A, 1e-4), atol=1e-9)
    expected = by_columns(differences(gradient, A, 1e-4))
    np.testing.assert_allclose(hessian(A, projected=False), expected, atol=1e-8)


@pytest.mark.parametrize("seed", range(6))
def test_projected_orthogonality_is_positive_semi_definite(seed: int) -> None:
    A = np.random.default_rng(seed).normal(size=(3, 3))
    block = hessian(A, projected=True)
    np.testing.assert_allclose(block, block.T, atol=1e-12)
    assert np.linalg.eigvalsh(block).min() > -1e-10


def test_rotations_cost_nothing_and_the_replacement_is_exact_there() -> None:
    A = random_rotation(np.random.default_rng(1))
    assert energy(A) < 1e-28
    np.testing.assert_allclose(gradient(A), 0, atol=1e-13)
    np.testing.assert_allclose(hessian(A, projected=True), hessian(A, projected=False), atol=1e-13)


def test_moments_of_a_box_match_the_closed_form() -> None:
    size, low = np.array([0.04, 0.03, 0.05]), np.array([0.01, -0.02, 0.005])
    volume, first, second = box_surface(size, low).moments
    centre = low + size / 2
    assert volume == pytest.approx(size.prod())
    np.testing.assert_allclose(first, size.prod() * centre)
    expected = size.prod() * (np.diag(size**2) / 12 + np.outer(centre, centre))
    np.testing.assert_allclose(second, expected, atol=1e-18)


def test_frame_points_reproduce_every_affine_map() -> None:
    random = np.random.default_rng(0)
    points, centroid, length = random.normal(size=(20, 3)), random.normal(size=3), 0.7
    A, t = random.normal(size=(3, 3)), random.normal(size=3)
    frame = (centroid + length * np.concatenate([np.zeros((1, 3)), np.eye(3)])) @ A.T + t
    np.testing.assert_allclose(frame_weights(points, centroid, length) @ frame, points @ A.T + t, atol=1e-12)
    np.testing.assert_allclose(np.array(affine_columns(frame, 0, length)).T, A, atol=1e-12)


@pytest.mark.parametrize("shape", list(PegShape))
def test_frame_mass_gives_the_kinetic_energy_of_the_solid(shape: PegShape) -> None:
    """1/2 sum m_kl v_k . v_l of an affine velocity field equals the integral over the solid's moments."""
    mesh = peg_surface(shape)
    volume, first, second = mesh.moments
    centroid, length = first / volume, 0.03
    mass = frame_mass(mesh, centroid, length, 500.0)
    random = np.random.default_rng(7)
    V, v = random.normal(size=(3, 3)), random.normal(size=3)
    frame = (centroid + length * np.concatenate([np.zeros((1, 3)), np.eye(3)])) @ V.T + v
    from_frame = 0.5 * np.einsum("kl,ki,li->", mass, frame, frame)
    integral = np.trace(V @ second @ V.T) + 2 * v @ V @ first + volume * v @ v
    assert from_frame == pytest.approx(0.5 * 500.0 * integral)
    assert mass.sum() == pytest.approx(500.0 * volume)
    assert np.linalg.eigvalsh(mass).min() > 0
