"""Solves the Newton system: a band matrix for the gels, bordered by a few rows and columns for the affine bodies.

    [ K  B ] [x]   [f]
    [ C  D ] [q] = [g]

K couples gel nodes in reverse Cuthill-McKee order. Friction makes the matrix unsymmetric, but its pattern is symmetric
and it stays close to a symmetric positive definite one, so Gaussian elimination needs no row exchanges. The three rows
of a node are eliminated together: that is one pass over the rows below instead of three.

All entries stand in one flat array, so that a 3 x 3 block is a place and a row stride whichever part it belongs to.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from .mat3 import Mat3

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# A pivot this small [N/m] against elastic ones of 1e2 to 1e6 N/m means a singular matrix.
_SMALLEST_PIVOT_N_M = 1e-6


class BlockLayout(NamedTuple):
    """Where the parts stand in the flat array, in units of entries, with n band rows and m border rows.

    K[i, j] at 2 w i + w + j, where w = 3 band_width + 2 is the half bandwidth;
    [B f][i, j] at right + i (m + 1) + j;  C[i, j] at bottom + i n + j;  [D g][i, j] at corner + i (m + 1) + j.
    """

    n: int
    m: int
    band_width: int  # in nodes
    w: int
    right: int
    bottom: int
    corner: int


class SystemLayout(NamedTuple):
    """Layout of a system, and how far elimination reaches in it."""

    block: BlockLayout
    size: int  # entries in all
    last: IndexArray  # [n / 3] last node that eliminating a node's rows reaches


def system_layout(last: IndexArray, band_width: int, border_rows: int) -> SystemLayout:
    """Layout for gel nodes whose elimination reaches the nodes `last`, and m border rows."""
    n, m, w = 3 * len(last), border_rows, 3 * band_width + 2
    right = (2 * w + 1) * n
    bottom = right + n * (m + 1)
    corner = bottom + m * n
    return SystemLayout(
        BlockLayout(n, m, band_width, w, right, bottom, corner),
        corner + m * (m + 1),
        last,
    )


@kernel
def block_place(layout: BlockLayout, a: int, b: int) -> tuple[int, int]:
    """Place and row stride of the block of unknowns a and b (three rows and columns each)."""
    n, i, j = layout.n, 3 * a, 3 * b
    if i < n:
        if j < n:
            return 2 * layout.w * i + layout.w + j, 2 * layout.w
        return layout.right + i * (layout.m + 1) + j - n, layout.m + 1
    if j < n:
        return layout.bottom + (i - n) * n + j, n
    return layout.corner + (i - n) * (layout.m + 1) + j - n, layout.m + 1


@kernel
def add_block(entries: FloatArray, place: int, stride: int, block: Mat3) -> None:
    """Add a 3 x 3 block, given by its rows."""
    entries[place] += block[0][0]
    entries[place + 1] += block[0][1]
    entries[place + 2] += block[0][2]
    entries[place + stride] += block[1][0]
    entries[place + stride + 1] += block[1][1]
    entries[place + stride + 2] += block[1][2]
    entries[place + 2 * stride] += block[2][0]
    entries[place + 2 * stride + 1] += block[2][1]
    entries[place + 2 * stride + 2] += block[2][2]


@kernel
def solve(system: SystemLayout, entries: FloatArray, solution: FloatArray, positive: bool) -> bool:
    """Solve, in place, into solution [n + m]; False, with the solution undefined, if a pivot vanishes.

    With `positive` it is also False if a pivot is negative: a symmetric matrix is then not positive definite.
    """
    if not _eliminate_band(system, entries, positive) or not _eliminate_corner(system.block, entries, positive):
        return False
    _substitute_back(system, entries, solution)
    return True


@kernel
def has_negative_determinant(system: SystemLayout, entries: FloatArray) -> bool:
    """Whether the determinant of a solved system's matrix, the product of its pivots, is negative."""
    layout = system.block
    negative = False
    for k in range(layout.n):
        if entries[2 * layout.w * k + layout.w + k] < 0.0:
            negative = not negative
    for k in range(layout.m):
        if entries[layout.corner + k * (layout.m + 1) + k] < 0.0:
            negative = not negative
    return negative


@kernel
def _usable(pivot: float, positive: bool) -> bool:
    return (pivot if positive else abs(pivot)) > _SMALLEST_PIVOT_N_M


@kernel
def _eliminate_band(system: SystemLayout, entries: FloatArray, positive: bool) -> bool:
    layout, last = system.block, system.last
    n, m, w = layout.n, layout.m, layout.w
    columns = m + 1
    longest = 3 * (layout.band_width + 1)
    upper = np.empty((3, longest))
    upper_right = np.empty((3, columns))
    for node in range(n // 3):
        k = 3 * node
        width = 3 * (last[node] + 1) - k
        if not _eliminate_within_node(entries, k, w, width, layout.right, columns, upper, upper_right, positive):
            return False
        a, b, c = 1.0 / upper[0, 0], 1.0 / upper[1, 1], 1.0 / upper[2, 2]
        u01, u02, u12 = upper[0, 1], upper[0, 2], upper[1, 2]
        for i in range(k + 3, k + width):
            row = i * 2 * w + w + k
            f0 = entries[row] * a
            f1 = (entries[row + 1] - f0 * u01) * b
            f2 = (entries[row + 2] - f0 * u02 - f1 * u12) * c
            _subtract_three(entries, row, 3, width, f0, f1, f2, upper)
            _subtract_three(entries, layout.right + i * columns, 0, columns, f0, f1, f2, upper_right)
        for i in range(m):
            row = layout.bottom + i * n + k
            f0 = entries[row] * a
            f1 = (entries[row + 1] - f0 * u01) * b
            f2 = (entries[row + 2] - f0 * u02 - f1 * u12) * c
            _subtract_three(entries, row, 3, width, f0, f1, f2, upper)
            _subtract_three(
                entries,
                layout.corner + i * columns,
                0,
                columns,
                f0,
                f1,
                f2,
                upper_right,
            )
    return True


@kernel
def _eliminate_within_node(
    entries: FloatArray,
    k: int,
    w: int,
    width: int,
    right: int,
    columns: int,
    upper: FloatArray,
    upper_right: FloatArray,
    positive: bool,
) -> bool:
    """Eliminate among a node's own three rows and copy them to `upper` [3, width] and `upper_right` [3, columns]."""
    for i in range(3):
        row = (k + i) * 2 * w + w + k
        right_row = right + (k + i) * columns
        for j in range(width):
            upper[i, j] = entries[row + j]
        for j in range(columns):
            upper_right[i, j] = entries[right_row + j]
        for p in range(i):
            factor = upper[i, p] / upper[p, p]
            for j in range(p, width):
                upper[i, j] -= factor * upper[p, j]
            for j in range(columns):
                upper_right[i, j] -= factor * upper_right[p, j]
        if not _usable(upper[i, i], positive):
            return False
        for j in range(i, width):
            entries[row + j] = upper[i, j]
        for j in range(columns):
            entries[right_row + j] = upper_right[i, j]
    return True


@kernel
def _subtract_three(
    entries: FloatArray,
    row: int,
    first: int,
    stop: int,
    f0: float,
    f1: float,
    f2: float,
    upper: FloatArray,
) -> None:
    for j in range(first, stop):
        entries[row + j] -= f0 * upper[0, j] + f1 * upper[1, j] + f2 * upper[2, j]


@kernel
def _eliminate_corner(layout: BlockLayout, entries: FloatArray, positive: bool) -> bool:
    m = layout.m
    for k in range(m):
        row_k = layout.corner + k * (m + 1)
        pivot = entries[row_k + k]
        if not _usable(pivot, positive):
            return False
        for i in range(k + 1, m):
            row_i = layout.corner + i * (m + 1)
            factor = entries[row_i + k] / pivot
            for j in range(k + 1, m + 1):
                entries[row_i + j] -= factor * entries[row_k + j]
    return True


@kernel
def _substitute_back(system: SystemLayout, entries: FloatArray, solution: FloatArray) -> None:
    layout, last = system.block, system.last
    n, m, w = layout.n, layout.m, layout.w
    for k in range(m - 1, -1, -1):
        row = layout.corner + k * (m + 1)
        total = entries[row + m]
        for j in range(k + 1, m):
            total -= entries[row + j] * solution[n + j]
        solution[n + k] = total / entries[row + k]
    for k in range(n - 1, -1, -1):
        row, right_row = k * 2 * w + w, layout.right + k * (m + 1)
        total = entries[right_row + m]
        for j in range(m):
            total -= entries[right_row + j] * solution[n + j]
        for j in range(k + 1, 3 * (last[k // 3] + 1)):
            total -= entries[row + j] * solution[j]
        solution[k] = total / entries[row + k]
