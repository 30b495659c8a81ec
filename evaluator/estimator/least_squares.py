"""Linear least squares in plain floating-point arithmetic: the same bits on every machine, without BLAS."""

from collections.abc import Sequence

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
    found: list[list[float]] = [[] for _ in range(n)]
    for row in reversed(range(n)):
        values = rows[row][n:]
        for other in range(row + 1, n):
            values = [value - rows[row][other] * known for value, known in zip(values, found[other], strict=True)]
        found[row] = [value / rows[row][row] for value in values]
    return found


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
