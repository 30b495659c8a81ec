"""Barrier, mollifier and friction: formulas, derivatives and smooth ends."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from vectors import differences, vec3
from vitac.envs.fem.contact.barrier import (
    barrier,
    mollifier,
    slip_factor,
    slip_potential,
    squared_cross_norm,
    squared_cross_norm_blocks,
    squared_cross_norm_gradient,
    update_dual,
)

FloatArray = NDArray[np.float64]
D_HAT = 1e-4
SLIP_SCALE = 1e-3
distances = pytest.mark.parametrize("d", [1e-9, 1e-6, 1e-5, 5e-5, 9e-5, 9.99e-5])


@distances
def test_barrier_follows_the_formula(d: float) -> None:
    assert barrier(d, D_HAT)[0] == pytest.approx(-((d - D_HAT) ** 2) * np.log(d / D_HAT), rel=1e-13)


@distances
def test_barrier_derivatives_match_differences(d: float) -> None:
    step = min(d, D_HAT - d) * 1e-2
    at = np.array([d])
    first = differences(lambda x: barrier(float(x[0]), D_HAT)[0], at, step)[0]
    second = differences(lambda x: barrier(float(x[0]), D_HAT)[1], at, step)[0]
    assert barrier(d, D_HAT)[1] == pytest.approx(first, rel=1e-5)
    assert barrier(d, D_HAT)[2] == pytest.approx(second, rel=1e-5)


@distances
def test_barrier_pushes_apart_and_is_convex(d: float) -> None:
    value, first, second = barrier(d, D_HAT)
    assert value > 0
    assert first < 0
    assert second > 0


def test_barrier_ends_smoothly_at_d_hat() -> None:
    """B, b' and b'' all go to zero there, so a contact appears without a kick."""
    value, first, second = barrier(D_HAT * (1 - 1e-8), D_HAT)
    assert abs(value) < 1e-15 * D_HAT**2
    assert abs(first) < 1e-14 * D_HAT
    assert abs(second) < 1e-6


def test_barrier_force_grows_without_bound() -> None:
    forces = [-barrier(D_HAT * 10.0**-k, D_HAT)[1] for k in range(1, 10)]
    assert all(b > a for a, b in pairwise(forces))
    assert forces[-1] > 1e4


@pytest.mark.parametrize("part", [0.0, 1e-6, 0.3, 0.9, 0.999999])
def test_mollifier_follows_the_formula_and_its_derivatives(part: float) -> None:
    eps = 3e-14
    c = part * eps
    e, first, second = mollifier(c, eps)
    assert e == pytest.approx(-(part**2) + 2 * part, abs=1e-15)
    assert first == pytest.approx((2 - 2 * part) / eps, rel=1e-9, abs=1e-9 / eps)
    assert second == pytest.approx(-2 / eps**2)


def test_mollifier_is_one_and_flat_from_its_threshold_on() -> None:
    assert mollifier(3e-14, 3e-14) == (1.0, 0.0, 0.0)
    assert mollifier(1.0, 3e-14) == (1.0, 0.0, 0.0)


def test_squared_cross_norm_and_its_derivatives() -> None:
    random = np.random.default_rng(0)
    uv = random.normal(size=(2, 3))

    def value(x: FloatArray) -> float:
        return squared_cross_norm(vec3(x[0]), vec3(x[1]))

    def gradient(x: FloatArray) -> FloatArray:
        return np.array(squared_cross_norm_gradient(vec3(x[0]), vec3(x[1])))

    assert value(uv) == pytest.approx(float(np.sum(np.cross(uv[0], uv[1]) ** 2)))
    np.testing.assert_allclose(gradient(uv), differences(value, uv, 1e-3), rtol=1e-9)
    uu, mixed, vv = (np.array(block) for block in squared_cross_norm_blocks(vec3(uv[0]), vec3(uv[1])))
    hessian = np.block([[uu, mixed], [mixed.T, vv]])
    np.testing.assert_allclose(hessian, differences(gradient, uv, 1e-3).reshape(6, 6), atol=1e-8)


def test_squared_cross_norm_of_parallel_edges_is_flat() -> None:
    gradient = np.array(squared_cross_norm_gradient((1.0, 2.0, -1.0), (2.0, 4.0, -2.0)))
    np.testing.assert_array_equal(gradient, 0)


@pytest.mark.parametrize("y", [1e-5, 1e-4, 5e-4, 9.9e-4, 1.01e-3, 5e-3])
def test_friction_force_is_the_derivative_of_its_potential(y: float) -> None:
    force = differences(lambda x: slip_potential(float(x[0]), SLIP_SCALE), np.array([y]), 2e-3 * y)[0]
    factor, second = slip_factor(y, SLIP_SCALE)
    assert factor * y == pytest.approx(force, rel=1e-7)
    slope = differences(lambda x: x[0] * slip_factor(float(x[0]), SLIP_SCALE)[0], np.array([y]), 2e-3 * y)[0]
    assert second * y * y + factor == pytest.approx(slope, rel=1e-6, abs=1e-6 / SLIP_SCALE)


def test_friction_reaches_the_coulomb_limit_and_stays() -> None:
    fraction = [y * slip_factor(y, SLIP_SCALE)[0] for y in np.linspace(1e-6, 3e-3, 100)]
    assert max(fraction) == pytest.approx(1.0, abs=1e-12)
    assert all(b >= a - 1e-15 for a, b in pairwise(fraction))


def test_friction_sticks_linearly_at_no_slip() -> None:
    assert slip_factor(0.0, SLIP_SCALE) == (2.0 / SLIP_SCALE, 0.0)
    assert slip_potential(0.0, SLIP_SCALE) == pytest.approx(SLIP_SCALE / 3)


def test_friction_potential_is_smooth_at_full_slip() -> None:
    below, above = SLIP_SCALE * (1 - 1e-9), SLIP_SCALE * (1 + 1e-9)
    assert slip_potential(below, SLIP_SCALE) == pytest.approx(slip_potential(above, SLIP_SCALE), rel=1e-8)
    assert slip_factor(below, SLIP_SCALE)[0] == pytest.approx(slip_factor(above, SLIP_SCALE)[0], rel=1e-8)


def newton_slips_m(load_n: float, spring_n_m: float, *, dual: bool) -> list[float]:
    """Newton's iterates of the slip at which a spring and a unit friction force hold a load, from a sliding start."""
    duals, slips, s = np.full((1, 6), np.nan), [2e-5], 1e-5
    for _ in range(12):
        u = (slips[-1], 0.0, 0.0)
        a, slope = slip_factor(abs(u[0]), s)
        stands_for_u = update_dual(duals, 0, u, s)[0] if dual else u[0]
        force = spring_n_m * u[0] - load_n + a * u[0]
        slips.append(u[0] - force / (spring_n_m + a + slope * stands_for_u * u[0]))
    return slips


@pytest.mark.parametrize("load_n", [-3.0, -0.9, 0.5, 0.99, 1.2])
def test_dual_variable_leads_newtons_method_to_the_slip_where_it_cycles_without(load_n: float) -> None:
    slips = newton_slips_m(load_n, 100.0, dual=True)
    u = slips[-1]
    assert 100.0 * u + u * slip_factor(abs(u), 1e-5)[0] == pytest.approx(load_n, rel=1e-9)


def test_newtons_method_without_a_dual_variable_does_not_find_the_slip() -> None:
    u = newton_slips_m(0.5, 100.0, dual=False)[-1]
    assert abs(100.0 * u + u * slip_factor(abs(u), 1e-5)[0] - 0.5) > 0.1


def test_all_agree_with_the_ipc_toolkit() -> None:
    ipctk = pytest.importorskip("ipctk", reason="the IPC Toolkit has no wheel for this machine")
    oracle = ipctk.ClampedLogBarrier()
    for d in (1e-8, 1e-5, 7e-5, 9.9e-5):
        ours = barrier(d, D_HAT)
        assert ours[0] == pytest.approx(oracle(d, D_HAT), rel=1e-12)
        assert ours[1] == pytest.approx(oracle.first_derivative(d, D_HAT), rel=1e-12)
        assert ours[2] == pytest.approx(oracle.second_derivative(d, D_HAT), rel=1e-11)
    for c in (0.0, 1e-15, 2e-14, 5e-14):
        assert mollifier(c, 3e-14)[0] == pytest.approx(ipctk.edge_edge_mollifier(c, 3e-14))
    for y in (0.0, 1e-5, 9e-4, 2e-3):
        assert slip_potential(y, SLIP_SCALE) == pytest.approx(ipctk.smooth_friction_f0(y, SLIP_SCALE), rel=1e-12)
        assert slip_factor(y, SLIP_SCALE)[0] == pytest.approx(ipctk.smooth_friction_f1_over_x(y, SLIP_SCALE), rel=1e-12)
