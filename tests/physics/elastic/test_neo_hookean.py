"""Energy, forces and stiffness of one tetrahedron belong together, and the replacement matrix is safe."""

import numpy as np
import pytest
from numpy.typing import NDArray
from vectors import columns3, differences, random_rotation, vec3
from vitac.envs.fem.algebra import apply_columns
from vitac.envs.fem.elastic.batch import Corners, cofactors, deformation_gradient
from vitac.envs.fem.elastic.neo_hookean import (
    Strained,
    lame_parameters_pa,
    nodal_gradient,
    projected_stiffness_block,
    stiffness_block,
    strain_energy_density,
)

FloatArray = NDArray[np.float64]
MU, LAMBDA = lame_parameters_pa(3e5, 0.3)


def rest_gradients(rest: FloatArray) -> tuple[FloatArray, float]:
    edges = (rest[1:] - rest[0]).T
    inner = np.linalg.inv(edges)
    return np.concatenate([-inner.sum(axis=0, keepdims=True), inner]), float(np.linalg.det(edges) / 6)


def deformed(seed: int, amount: float = 0.3) -> tuple[FloatArray, FloatArray, float]:
    """Positions [m], rest gradients and volume of a random tetrahedron, strained and turned."""
    random = np.random.default_rng(seed)
    rest = np.concatenate([np.zeros((1, 3)), np.eye(3)]) * 3e-3 + random.normal(size=(4, 3)) * 3e-4
    g, volume = rest_gradients(rest)
    axes = random_rotation(random)
    strain = axes @ np.diag(1 + amount * random.uniform(-1, 1, 3)) @ axes.T
    return rest @ strain.T @ random_rotation(random).T, g, volume


def corners(rows: FloatArray) -> Corners:
    return vec3(rows[0]), vec3(rows[1]), vec3(rows[2]), vec3(rows[3])


def energy(x: FloatArray, g: FloatArray, volume: float) -> float:
    F = deformation_gradient(corners(x), corners(g))
    _, J = cofactors(F)
    return volume * strain_energy_density(F, J, MU, LAMBDA)


def state(x: FloatArray, g: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """F g_a, h_a = F^-T g_a and the pressure term, from numpy."""
    F = x.T @ g
    return (F @ g.T).T, (np.linalg.inv(F).T @ g.T).T, LAMBDA * np.log(np.linalg.det(F)) - MU


def gradient(x: FloatArray, g: FloatArray, volume: float) -> FloatArray:
    Fg, h, pressure = state(x, g)
    return np.array([nodal_gradient(volume, MU, pressure, vec3(Fg[a]), vec3(h[a])) for a in range(4)])


def hessian(x: FloatArray, g: FloatArray, volume: float, *, projected: bool = False) -> FloatArray:
    _, h, pressure = state(x, g)
    inverse = np.linalg.inv(x.T @ g)
    s = Strained(volume, MU, LAMBDA, float(pressure), corners(g), corners(h), columns3(inverse.T @ inverse))
    blocks = np.empty((4, 3, 4, 3))
    for a in range(4):
        for b in range(4):
            blocks[a, :, b] = projected_stiffness_block(s, a, b) if projected else stiffness_block(s, a, b)
    return blocks.reshape(12, 12)


def test_lame_parameters_of_the_gel() -> None:
    assert pytest.approx(115384.615, rel=1e-8) == MU
    assert pytest.approx(173076.923, rel=1e-8) == LAMBDA


def test_deformation_gradient_is_that_of_the_affine_map() -> None:
    random = np.random.default_rng(3)
    rest = random.normal(size=(4, 3))
    g, _ = rest_gradients(rest)
    map_ = random.normal(size=(3, 3))
    F = deformation_gradient(corners(rest @ map_.T + 5.0), corners(g))
    np.testing.assert_allclose(np.array(F).T, map_, rtol=1e-9, atol=1e-9)


def test_cofactors_are_determinant_times_inverse_transpose() -> None:
    matrix = np.random.default_rng(4).normal(size=(3, 3))
    cofactor, J = cofactors(columns3(matrix))
    assert pytest.approx(np.linalg.det(matrix), rel=1e-12) == J
    np.testing.assert_allclose(np.array(cofactor).T, J * np.linalg.inv(matrix).T, rtol=1e-10)
    np.testing.assert_allclose(apply_columns(columns3(matrix), (1.0, 2.0, 3.0)), matrix @ [1.0, 2.0, 3.0])


def test_energy_density_follows_the_formula_and_vanishes_at_rest() -> None:
    assert strain_energy_density(columns3(np.eye(3)), 1.0, MU, LAMBDA) == 0.0
    F = np.eye(3) + 0.2 * np.random.default_rng(5).normal(size=(3, 3))
    log_j = np.log(np.linalg.det(F))
    expected = 0.5 * MU * (np.trace(F.T @ F) - 3) - MU * log_j + 0.5 * LAMBDA * log_j**2
    assert strain_energy_density(columns3(F), float(np.linalg.det(F)), MU, LAMBDA) == pytest.approx(expected)


@pytest.mark.parametrize("seed", range(5))
def test_gradient_is_the_derivative_of_the_energy(seed: int) -> None:
    x, g, volume = deformed(seed)
    expected = differences(lambda y: energy(y, g, volume), x, 1e-6)
    np.testing.assert_allclose(gradient(x, g, volume), expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(5))
def test_stiffness_is_the_derivative_of_the_gradient(seed: int) -> None:
    x, g, volume = deformed(seed)
    expected = differences(lambda y: gradient(y, g, volume).ravel(), x, 1e-6).reshape(12, 12)
    np.testing.assert_allclose(hessian(x, g, volume), expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(5))
def test_rigid_motion_leaves_energy_and_turns_forces(seed: int) -> None:
    x, g, volume = deformed(seed)
    turn = random_rotation(np.random.default_rng(seed + 100))
    assert energy(x @ turn.T + 0.01, g, volume) == pytest.approx(energy(x, g, volume), rel=1e-9)
    before, after = gradient(x, g, volume), gradient(x @ turn.T + 0.01, g, volume)
    np.testing.assert_allclose(after, before @ turn.T, atol=1e-9 * np.abs(before).max())


@pytest.mark.parametrize("amount", [0.05, 0.4, 0.7])
@pytest.mark.parametrize("seed", range(10))
def test_projected_stiffness_is_symmetric_positive_semi_definite_and_never_softer(seed: int, amount: float) -> None:
    x, g, volume = deformed(seed, amount)
    exact, replaced = hessian(x, g, volume), hessian(x, g, volume, projected=True)
    size = np.abs(replaced).max()
    np.testing.assert_allclose(replaced, replaced.T, atol=1e-12 * size)
    assert np.linalg.eigvalsh(replaced).min() > -1e-12 * size
    assert np.linalg.eigvalsh(replaced - exact).min() > -1e-12 * size


def test_exact_stiffness_can_be_indefinite_so_the_replacement_is_needed() -> None:
    g, volume = rest_gradients(np.concatenate([np.zeros((1, 3)), np.eye(3)]) * 3e-3)
    squeezed = np.concatenate([np.zeros((1, 3)), np.diag([0.3, 0.3, 0.3])]) * 3e-3
    assert np.linalg.eigvalsh(hessian(squeezed, g, volume)).min() < 0
    assert np.linalg.eigvalsh(hessian(squeezed, g, volume, projected=True)).min() > -1e-9


def test_replacement_is_exact_where_the_doubtful_term_vanishes() -> None:
    """At ln J = mu / lambda the factor mu - lambda ln J of the indefinite term is zero."""
    g, volume = rest_gradients(np.concatenate([np.zeros((1, 3)), np.eye(3)]) * 3e-3)
    stretched = np.concatenate([np.zeros((1, 3)), np.eye(3)]) * 3e-3 * np.exp(MU / LAMBDA / 3)
    exact, replaced = hessian(stretched, g, volume), hessian(stretched, g, volume, projected=True)
    np.testing.assert_allclose(replaced, exact, atol=1e-10 * np.abs(exact).max())
