"""Vectors and matrices as tuples against NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from vectors import columns3, vec3
from vitac.envs.fem import algebra
from vitac.envs.fem import algebra as tuples
from vitac.envs.fem.algebra import Mat3, add_rows, any_nonzero, copy_rows, scale_rows

FloatArray = NDArray[np.float64]
seeds = given(st.integers(0, 10**6))
some = settings(max_examples=25)


def rows3(matrix: FloatArray) -> Mat3:
    return columns3(matrix.T)


@some
@seeds
def test_products_of_vectors_are_numpys(seed: int) -> None:
    a, b, c = np.random.default_rng(seed).normal(size=(3, 3))
    assert tuples.dot(vec3(a), vec3(b)) == pytest.approx(a @ b)
    assert tuples.cross(vec3(a), vec3(b)) == pytest.approx(np.cross(a, b))
    assert tuples.combine(2.0, vec3(a), -3.0, vec3(b), 0.5, vec3(c)) == pytest.approx(2.0 * a - 3.0 * b + 0.5 * c)


@some
@seeds
def test_products_of_matrices_are_numpys(seed: int) -> None:
    A, B = np.random.default_rng(seed).normal(size=(2, 3, 3))
    v = A[0] - B[1]
    assert algebra.apply_rows(rows3(A), vec3(v)) == pytest.approx(A @ v)
    assert algebra.apply_columns(columns3(A), vec3(v)) == pytest.approx(A @ v)
    np.testing.assert_allclose(algebra.multiply_rows(rows3(A), rows3(B)), A @ B, atol=1e-12)
    np.testing.assert_allclose(algebra.outer_square(columns3(A)), A @ A.T, atol=1e-12)


@some
@seeds
def test_identity_and_outer_products_are_numpys(seed: int) -> None:
    a, b = np.random.default_rng(seed).normal(size=(2, 3))
    expected = 2.0 * np.eye(3) + 3.0 * np.outer(a, b) - 0.5 * np.outer(b, a)
    np.testing.assert_allclose(algebra.identity_and_outers(2.0, 3.0, vec3(a), vec3(b), -0.5), expected, atol=1e-12)
    symmetric = algebra.identity_and_outer(2.0, 3.0, vec3(a))
    np.testing.assert_allclose(symmetric, 2.0 * np.eye(3) + 3.0 * np.outer(a, a), atol=1e-12)


def test_transposing_turns_rows_into_columns_and_back() -> None:
    A = np.arange(9.0).reshape(3, 3)
    assert algebra.transpose(rows3(A)) == columns3(A)
    assert algebra.transpose(algebra.transpose(rows3(A))) == rows3(A)


def test_target_of_a_sum_of_rows_may_be_one_of_its_terms() -> None:
    a, b = np.random.default_rng(0).normal(size=(2, 4, 3))
    for target in (a.copy(), b.copy()):
        first, second = (target, b) if (target == a).all() else (a, target)
        add_rows(first, -0.25, second, target)
        np.testing.assert_array_equal(target, a - 0.25 * b)


def test_rows_are_copied_and_scaled_in_place() -> None:
    source, target = np.random.default_rng(1).normal(size=(4, 3)), np.zeros((4, 3))
    copy_rows(source, target)
    scale_rows(-2.0, target)
    np.testing.assert_array_equal(target, -2.0 * source)


@pytest.mark.parametrize("place", [(0, 0), (1, 2), (3, 1)])
@pytest.mark.parametrize("value", [1e-300, -1.0, np.nan])
def test_a_single_component_that_is_not_zero_is_found(place: tuple[int, int], value: float) -> None:
    rows = np.zeros((4, 3))
    rows[2, 2] = -0.0
    assert not any_nonzero(rows)
    rows[place] = value
    assert any_nonzero(rows)
