"""The libm-free functions against an independent implementation, and at the ends of their ranges."""

import math
from decimal import Decimal, localcontext

import numpy as np
import pytest
from vitac.envs.deterministic_math import arctangent_deg, natural_log, normal_pairs, sine_cosine

SMALLEST_NORMAL = 2.2250738585072014e-308


def ulp_error(value: float, argument: float) -> float:
    """Error of a logarithm in units in the last place, against 40 decimal digits."""
    with localcontext() as context:
        context.prec = 40
        exact = Decimal(argument).ln()
        return float(abs(Decimal(value) - exact) / Decimal(math.ulp(float(exact)) if exact else math.ulp(0.0)))


def test_logarithm_is_within_one_ulp() -> None:
    random = np.random.default_rng(0)
    near_one = 1.0 + random.uniform(-1e-3, 1e-3, 500)
    everywhere = np.exp(random.uniform(-700, 700, 500))
    around_half_octaves = np.sqrt(0.5) * (1.0 + random.uniform(-1e-12, 1e-12, 200)) * 2.0 ** random.integers(-9, 9, 200)
    arguments = np.concatenate([near_one, everywhere, random.uniform(1e-6, 1.0, 500), around_half_octaves])
    assert max(ulp_error(natural_log(x), x) for x in arguments.tolist()) <= 1.0


@pytest.mark.parametrize("x", [SMALLEST_NORMAL, 1.7976931348623157e308, math.nextafter(1.0, 0.0), math.nextafter(1, 2)])
def test_logarithm_at_the_ends_of_its_range(x: float) -> None:
    assert natural_log(x) == pytest.approx(math.log(x), rel=3e-16)


def test_logarithm_of_one_is_exactly_zero() -> None:
    assert natural_log(1.0) == 0.0


@pytest.mark.parametrize("x", [0.0, -1.0, -math.inf, math.inf, math.nan, SMALLEST_NORMAL / 2])
def test_logarithm_of_anything_else_is_nan(x: float) -> None:
    assert math.isnan(natural_log(x))


def test_logarithm_never_falls() -> None:
    for start in (0.5, 0.7071067811865476, 1.0, 1.4142135623730951, 2.0):
        x, previous = start - 100 * math.ulp(start), -math.inf
        for _ in range(200):
            value = natural_log(x)
            assert value >= previous
            x, previous = math.nextafter(x, math.inf), value


def test_sine_and_cosine_are_within_1e_15() -> None:
    random = np.random.default_rng(1)
    arguments = np.concatenate([random.uniform(-7, 7, 3000), random.uniform(-1e4, 1e4, 3000), [0.0, 1e4, -1e4]])
    for x in arguments.tolist():
        sine, cosine = sine_cosine(x)
        assert abs(sine - math.sin(x)) < 1e-15
        assert abs(cosine - math.cos(x)) < 1e-15


def test_sine_is_odd_and_cosine_is_even() -> None:
    for x in np.random.default_rng(2).uniform(0.01, 10, 300).tolist():
        assert sine_cosine(-x) == (-sine_cosine(x)[0], sine_cosine(x)[1])


def test_no_turn_is_exact() -> None:
    assert sine_cosine(0.0) == (0.0, 1.0)


@pytest.mark.parametrize("x", [1.1e4, -math.inf, math.nan])
def test_angles_out_of_range_give_nan(x: float) -> None:
    assert all(math.isnan(value) for value in sine_cosine(x))


def test_angle_of_a_point_is_that_of_libm_all_around() -> None:
    points = np.random.default_rng(4).normal(size=(3000, 2)) * [[1.0, 1e-3]]
    for x, y in [*points.tolist(), *(points[:, ::-1]).tolist(), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]:
        assert arctangent_deg(y, x) == pytest.approx(math.degrees(math.atan2(y, x)), abs=1e-13)


def test_normal_pairs_are_normal_and_independent() -> None:
    from scipy.stats import kstest

    normal = normal_pairs(np.random.default_rng(3).random((50_000, 2)))
    assert kstest(normal.ravel(), "norm").pvalue > 0.01
    assert abs(np.corrcoef(normal.T)[0, 1]) < 0.01
    assert abs(np.corrcoef((normal**2).T)[0, 1]) < 0.01


def test_normal_pairs_follow_box_and_muller_from_end_to_end() -> None:
    largest = math.nextafter(1.0, 0.0)
    uniform = np.array([[0.0, 0.3], [0.5, 0.0], [0.9, 0.125], [largest, largest]])
    radius = np.sqrt(-2 * np.log(1 - uniform[:, 0]))
    angle = 2 * np.pi * uniform[:, 1]
    expected = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    np.testing.assert_allclose(normal_pairs(uniform), expected, rtol=1e-14, atol=1e-14)
