import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.regression import normal_equations, solve


@given(st.integers(0, 10**6), st.integers(1, 6), st.integers(1, 3))
def test_solution_is_that_of_numpy(seed: int, n: int, m: int) -> None:
    random = np.random.default_rng(seed)
    matrix, right = random.normal(size=(n, n)) + 3.0 * np.eye(n), random.normal(size=(n, m))
    np.testing.assert_allclose(solve(matrix.tolist(), right.tolist()), np.linalg.solve(matrix, right), atol=1e-9)


def test_rows_are_exchanged_where_the_first_pivot_is_zero() -> None:
    assert solve([[0.0, 1.0], [2.0, 0.0]], [[3.0], [4.0]]) == [[2.0], [3.0]]


def test_arguments_stay_as_they_were() -> None:
    matrix, right = [[0.0, 1.0], [2.0, 0.0]], [[3.0], [4.0]]
    solve(matrix, right)
    assert (matrix, right) == ([[0.0, 1.0], [2.0, 0.0]], [[3.0], [4.0]])


def test_singular_matrix_is_refused() -> None:
    with pytest.raises(ValueError, match="column 1 depends on those before it"):
        solve([[1.0, 2.0], [2.0, 4.0]], [[1.0], [2.0]])


@given(st.integers(0, 10**6))
def test_normal_equations_are_the_products(seed: int) -> None:
    random = np.random.default_rng(seed)
    rows, targets = random.normal(size=(7, 3)), random.normal(size=(7, 2))
    squares, products = normal_equations(rows.tolist(), targets.tolist())
    np.testing.assert_allclose(squares, rows.T @ rows, atol=1e-12)
    np.testing.assert_allclose(products, rows.T @ targets, atol=1e-12)
