"""Closed-form ridge regression from features to the offset: the same bits on every machine, without BLAS."""

import hashlib
from collections.abc import Sequence

from .strict_model import StrictModel

Row = Sequence[float]


def solve(matrix: Sequence[Row], right: Sequence[Row]) -> list[list[float]]:
    """Return X of matrix X = right by Gaussian elimination with partial pivoting.

    Args:
        matrix: regular, shape [n, n].
        right: shape [n, m].

    Returns:
        Shape [n, m].

    Raises:
        ValueError: the matrix is singular.
    """
    rows = [[*left, *others] for left, others in zip(matrix, right, strict=True)]
    n = len(rows)
    for column in range(n):
        pivot = max(range(column, n), key=lambda row: abs(rows[row][column]))
        if rows[pivot][column] == 0.0:
            raise ValueError(f"expected a regular matrix, column {column} depends on those before it")
        rows[column], rows[pivot] = rows[pivot], rows[column]
        head = rows[column]
        for row in range(column + 1, n):
            factor = rows[row][column] / head[column]
            rows[row] = [value - factor * above for value, above in zip(rows[row], head, strict=True)]
    solution: list[list[float]] = [[] for _ in range(n)]
    for row in reversed(range(n)):
        values = rows[row][n:]
        for other in range(row + 1, n):
            values = [value - rows[row][other] * known for value, known in zip(values, solution[other], strict=True)]
        solution[row] = [value / rows[row][row] for value in values]
    return solution


def normal_equations(rows: Sequence[Row], targets: Sequence[Row]) -> tuple[list[list[float]], list[list[float]]]:
    """Return A^T A, shape [n, n], and A^T b, shape [n, m], summed row after row.

    Args:
        rows: A, shape [k, n].
        targets: b, shape [k, m].
    """
    n, m = len(rows[0]), len(targets[0])
    squares, products = [[0.0] * n for _ in range(n)], [[0.0] * m for _ in range(n)]
    for row, target in zip(rows, targets, strict=True):
        for i, value in enumerate(row):
            squares[i] = [total + value * other for total, other in zip(squares[i], row, strict=True)]
            products[i] = [total + value * other for total, other in zip(products[i], target, strict=True)]
    return squares, products


# Share of a standardised feature's variance that is added (ridge).
_RIDGE = 0.03
# Added to variances of the error [mm2, mm2, deg2], so that no estimate is ever taken as certain.
_LEAST_VARIANCE = 0.05


class Regression(StrictModel):
    """A linear map of standardised features, and how far off it was where it was fitted.

    `weights` has one row for the constant, then one for each feature; `variances` are those of the targets' errors.
    """

    means: tuple[float, ...]
    scales: tuple[float, ...]
    weights: tuple[tuple[float, ...], ...]
    variances: tuple[float, ...]

    def predict(self, features: Row) -> list[float]:
        """Return the targets, shape [m]."""
        predicted = list(self.weights[0])
        for value, mean, scale, row in zip(features, self.means, self.scales, self.weights[1:], strict=True):
            standard = (value - mean) / scale
            predicted = [total + standard * weight for total, weight in zip(predicted, row, strict=True)]
        return predicted


class Coefficients(StrictModel):
    """All that the standard estimator has learned of a sensor: a regression for each of the first env steps."""

    format: int = 1
    mesh_hash: str
    starts: int
    regressions: tuple[Regression, ...]

    def as_bytes(self) -> bytes:
        """Return what is stored; its digest names the coefficients."""
        return self.model_dump_json().encode() + b"\n"

    @property
    def digest(self) -> str:
        """SHA-256 [hex] of what is stored."""
        return hashlib.sha256(self.as_bytes()).hexdigest()


def fit(rows: Sequence[Row], targets: Sequence[Row]) -> Regression:
    """Return the ridge regression of targets on standardised features.

    With standardised features Z and n rows, the weights solve (Z^T Z + 0.03 n I) w = Z^T t, the constant without
    penalty (A. E. Hoerl and R. W. Kennard, Ridge regression, Technometrics 12 (1970) 55-67, equation 2.1).

    Args:
        rows: features, shape [n, k].
        targets: shape [n, m].
    """
    n = len(rows)
    means = [_mean(column) for column in zip(*rows, strict=True)]
    spreads = [
        _mean([(value - mean) * (value - mean) for value in column]) ** 0.5
        for column, mean in zip(zip(*rows, strict=True), means, strict=True)
    ]
    scales = [spread if spread > 0.0 else 1.0 for spread in spreads]
    standard = [
        [1.0, *((value - mean) / scale for value, mean, scale in zip(row, means, scales, strict=True))] for row in rows
    ]
    squares, products = normal_equations(standard, targets)
    for feature in range(1, len(squares)):
        squares[feature][feature] += _RIDGE * n
    weights = solve(squares, products)
    fitted = Regression(
        means=tuple(means), scales=tuple(scales), weights=tuple(map(tuple, weights)), variances=(0.0,) * len(targets[0])
    )
    errors = [
        [predicted - wanted for predicted, wanted in zip(fitted.predict(row), target, strict=True)]
        for row, target in zip(rows, targets, strict=True)
    ]
    variances = [_mean([error * error for error in column]) + _LEAST_VARIANCE for column in zip(*errors, strict=True)]
    return fitted.model_copy(update={"variances": tuple(variances)})


def _mean(values: Sequence[float]) -> float:
    total = 0.0
    for value in values:
        total += value
    return total / len(values)
