"""Solves the Newton system by multifrontal elimination (Duff & Reid, ACM TOMS 1983), unsymmetric, without exchanges.

Friction makes the matrix unsymmetric, but its pattern is symmetric and it stays close to a symmetric positive definite
one, so Gaussian elimination needs no row exchanges: which rows meet is known before any number is. Every front is a
small dense matrix, of which the three rows of a node are the unit of work.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel, large_kernel
from .linear_system import BlockLayout, Fronts, SystemLayout

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
Row3 = tuple[float, float, float]

# A pivot this small [N/m] against elastic ones of 1e2 to 1e6 N/m means a singular matrix.
_SMALLEST_PIVOT_N_M = 1e-6
# Pivot rows in a panel: with the width of large fronts these fit the second-level cache.
_PANEL_ROWS = 48


class Factor(NamedTuple):
    """The factors of a matrix, and what it takes to make them."""

    entries: FloatArray  # for each front its pivot rows, then the multipliers of the rows below, row by row
    negative_pivots: IndexArray  # [1]
    front: FloatArray  # the front at work, row by row
    stack: FloatArray  # what fronts have passed on
    inverse_pivots: FloatArray  # [w] of the front at work
    near: FloatArray  # [w] solution at the rows of a front


def new_factor(system: SystemLayout) -> Factor:
    """Arrays for the factors of a system of this layout."""
    fronts = system.fronts
    return Factor(
        entries=np.empty(fronts.factors),
        negative_pivots=np.zeros(1, dtype=np.int64),
        front=np.empty(fronts.widest**2),
        stack=np.empty(fronts.stack),
        inverse_pivots=np.empty(fronts.widest),
        near=np.empty(fronts.widest),
    )


@large_kernel
def factorise(system: SystemLayout, entries: FloatArray, factor: Factor, positive: bool) -> bool:
    """Write the factors of the matrix in `entries`; False, with the factors undefined, if a pivot vanishes.

    With `positive` it is also False if a pivot is negative: a symmetric matrix is then not positive definite.
    """
    fronts = system.fronts
    factor.negative_pivots[0] = 0
    for f in range(len(fronts.factor)):
        pivots = 3 * (fronts.first[f + 1] - fronts.first[f])
        size = pivots + 3 * (fronts.row_start[f + 1] - fronts.row_start[f])
        front = factor.front[: size * size]
        front[:] = 0.0
        _load(system.block, system.neighbours.start, fronts, f, entries, front, size)
        for c in range(fronts.child_start[f], fronts.child_start[f + 1]):
            _add_child(fronts, fronts.children[c], factor.stack, front, size)
        if not _eliminate(front, size, pivots, factor.inverse_pivots, factor.negative_pivots, positive):
            return False
        _store(front, size, pivots, factor.entries[fronts.factor[f] :], factor.stack[fronts.passed[f] :])
    return True


@kernel
def has_negative_determinant(factor: Factor) -> bool:
    """Whether the determinant of a factorised matrix, the product of its pivots, is negative."""
    return bool(factor.negative_pivots[0] % 2 == 1)


@large_kernel
def substitute(system: SystemLayout, factor: Factor, x: FloatArray) -> None:
    """Solve with the factors, in place: x [n + m] is the right-hand side, then the solution."""
    fronts = system.fronts
    for f in range(len(fronts.factor)):
        _substitute_forward(fronts, f, factor.entries[fronts.factor[f] :], x)
    for f in range(len(fronts.factor) - 1, -1, -1):
        _substitute_back(fronts, f, factor.entries[fronts.factor[f] :], x, factor.near)


@kernel
def _load(
    block: BlockLayout, start: IndexArray, fronts: Fronts, f: int, entries: FloatArray, front: FloatArray, size: int
) -> None:
    """Write the matrix's own blocks in the rows and columns of the front's pivots."""
    first, stop, n, m = fronts.first[f], fronts.first[f + 1], block.nodes, block.m
    if first == n:
        _copy(entries[block.corner :], front, m * m)
        return
    for a in range(first, stop):
        i = a - first
        _put(entries, 9 * a, front, 3 * i * size + 3 * i, size)
        for k in range(start[a], start[a + 1]):
            j = fronts.local[k]
            if j >= 0:
                _put(entries, 9 * (n + k), front, 3 * i * size + 3 * j, size)
                if j >= stop - first:
                    _put(entries, 9 * (n + fronts.mirrored[k]), front, 3 * j * size + 3 * i, size)
        for row in range(3):
            _copy(entries[block.right + (3 * a + row) * m :], front[(3 * i + row + 1) * size - m :], m)
        for row in range(0, m, 3):
            _put(entries, block.bottom + 3 * (m * a + row), front, (size - m + row) * size + 3 * i, size)


@kernel
def _put(entries: FloatArray, source: int, front: FloatArray, place: int, size: int) -> None:
    block = entries[source : source + 9]
    r0, r1, r2 = (
        front[place : place + 3],
        front[place + size : place + size + 3],
        front[place + 2 * size : place + 2 * size + 3],
    )
    r0[0], r0[1], r0[2] = block[0], block[1], block[2]
    r1[0], r1[1], r1[2] = block[3], block[4], block[5]
    r2[0], r2[1], r2[2] = block[6], block[7], block[8]


@kernel
def _copy(source: FloatArray, target: FloatArray, count: int) -> None:
    for i in range(count):
        target[i] = source[i]


@kernel
def _add_child(fronts: Fronts, child: int, stack: FloatArray, front: FloatArray, size: int) -> None:
    """Add what a child has passed on."""
    slot = fronts.slot[fronts.row_start[child] : fronts.row_start[child + 1]]
    width = 3 * len(slot)
    place = fronts.passed[child]
    for i in range(len(slot)):
        for row in range(3):
            passed = stack[place : place + width]
            target = front[(3 * slot[i] + row) * size : (3 * slot[i] + row + 1) * size]
            for j in range(len(slot)):
                column = 3 * slot[j]
                target[column] += passed[3 * j]
                target[column + 1] += passed[3 * j + 1]
                target[column + 2] += passed[3 * j + 2]
            place += width


@kernel
def _eliminate(
    front: FloatArray,
    size: int,
    pivots: int,
    inverse_pivots: FloatArray,
    negative_pivots: IndexArray,
    positive: bool,
) -> bool:
    """Eliminate the pivots; multipliers take the place of what they eliminate.

    A panel of pivot rows stays in the cache while all rows below pass by; the size of panels changes no bit.
    """
    for start in range(0, pivots, _PANEL_ROWS):
        stop = min(start + _PANEL_ROWS, pivots)
        for i in range(start, size, 3):
            for k in range(start, min(i, stop), 3):
                _eliminate_node(front, size, i, k, inverse_pivots)
            if i < stop and not _eliminate_within_node(front, size, i, inverse_pivots, negative_pivots, positive):
                return False
    return True


@kernel
def _eliminate_node(front: FloatArray, size: int, i: int, k: int, inverse_pivots: FloatArray) -> None:
    """Eliminate the pivots of the node at row k from the three rows at i."""
    u, r = k * size, i * size
    u0, u1, u2 = front[u + k : u + size], front[u + size + k : u + 2 * size], front[u + 2 * size + k : u + 3 * size]
    r0, r1, r2 = front[r + k : r + size], front[r + size + k : r + 2 * size], front[r + 2 * size + k : r + 3 * size]
    a, b, c = inverse_pivots[k], inverse_pivots[k + 1], inverse_pivots[k + 2]
    f0 = _multipliers(r0, u0, u1, a, b, c)
    f1 = _multipliers(r1, u0, u1, a, b, c)
    f2 = _multipliers(r2, u0, u1, a, b, c)
    _subtract_products(r0[3:], r1[3:], r2[3:], f0, f1, f2, u0[3:], u1[3:], u2[3:])


@kernel
def _eliminate_within_node(
    front: FloatArray, size: int, k: int, inverse_pivots: FloatArray, negative_pivots: IndexArray, positive: bool
) -> bool:
    """Eliminate a node's own three pivots from each other's rows and write their inverses."""
    u = k * size
    u0, u1, u2 = front[u + k : u + size], front[u + size + k : u + 2 * size], front[u + 2 * size + k : u + 3 * size]
    if not _usable(u0[0], negative_pivots, positive):
        return False
    f = u1[0] / u0[0]
    g = u2[0] / u0[0]
    u1[0], u2[0] = f, g
    for j in range(1, len(u0)):
        u1[j] -= f * u0[j]
        u2[j] -= g * u0[j]
    if not _usable(u1[1], negative_pivots, positive):
        return False
    g = u2[1] / u1[1]
    u2[1] = g
    for j in range(2, len(u0)):
        u2[j] -= g * u1[j]
    inverse_pivots[k], inverse_pivots[k + 1], inverse_pivots[k + 2] = 1.0 / u0[0], 1.0 / u1[1], 1.0 / u2[2]
    return _usable(u2[2], negative_pivots, positive)


@kernel
def _usable(pivot: float, negative_pivots: IndexArray, positive: bool) -> bool:
    if pivot < 0.0:
        negative_pivots[0] += 1
    return (pivot if positive else abs(pivot)) > _SMALLEST_PIVOT_N_M


@kernel
def _multipliers(row: FloatArray, u0: FloatArray, u1: FloatArray, a: float, b: float, c: float) -> Row3:
    """Write and return the multipliers that eliminate a row's first three entries; a, b, c are inverse pivots."""
    f0 = row[0] * a
    f1 = (row[1] - f0 * u0[1]) * b
    f2 = (row[2] - f0 * u0[2] - f1 * u1[2]) * c
    row[0], row[1], row[2] = f0, f1, f2
    return f0, f1, f2


@kernel
def _subtract_products(
    r0: FloatArray,
    r1: FloatArray,
    r2: FloatArray,
    f0: Row3,
    f1: Row3,
    f2: Row3,
    u0: FloatArray,
    u1: FloatArray,
    u2: FloatArray,
) -> None:
    """Three rows less their multiples of three pivot rows: where the time of large systems goes.

    Slices whose indices cannot be negative are what lets the compiler use vectors.
    """
    a0, a1, a2 = f0
    b0, b1, b2 = f1
    c0, c1, c2 = f2
    for j in range(len(r0)):
        x, y, z = u0[j], u1[j], u2[j]
        r0[j] -= a0 * x + a1 * y + a2 * z
        r1[j] -= b0 * x + b1 * y + b2 * z
        r2[j] -= c0 * x + c1 * y + c2 * z


@kernel
def _store(front: FloatArray, size: int, pivots: int, factors: FloatArray, passed: FloatArray) -> None:
    """Keep the factors, and pass the rest on."""
    _copy(front, factors, pivots * size)
    left = size - pivots
    for i in range(left):
        row = front[(pivots + i) * size : (pivots + i + 1) * size]
        _copy(row, factors[pivots * (size + i) :], pivots)
        _copy(row[pivots:], passed[i * left :], left)


@kernel
def _substitute_forward(fronts: Fronts, f: int, factors: FloatArray, x: FloatArray) -> None:
    first = fronts.first[f]
    pivots = 3 * (fronts.first[f + 1] - first)
    rows = fronts.rows[fronts.row_start[f] : fronts.row_start[f + 1]]
    size = pivots + 3 * len(rows)
    y = x[3 * first : 3 * first + pivots]
    for k in range(0, pivots, 3):
        t0, t1, t2 = _three_products(factors[k * size :], size, y, k)
        row = (k + 1) * size + k
        y[k] -= t0
        y[k + 1] -= t1 + factors[row] * y[k]
        y[k + 2] -= t2 + factors[row + size] * y[k] + factors[row + size + 1] * y[k + 1]
    for i in range(len(rows)):
        t0, t1, t2 = _three_products(factors[pivots * (size + 3 * i) :], pivots, y, pivots)
        node = 3 * rows[i]
        x[node] -= t0
        x[node + 1] -= t1
        x[node + 2] -= t2


@kernel
def _substitute_back(fronts: Fronts, f: int, factors: FloatArray, x: FloatArray, near: FloatArray) -> None:
    first = fronts.first[f]
    pivots = 3 * (fronts.first[f + 1] - first)
    rows = fronts.rows[fronts.row_start[f] : fronts.row_start[f + 1]]
    size = pivots + 3 * len(rows)
    y = x[3 * first : 3 * first + pivots]
    _copy(y, near, pivots)
    for i in range(len(rows)):
        for k in range(3):
            near[pivots + 3 * i + k] = x[3 * rows[i] + k]
    for k in range(pivots - 3, -1, -3):
        row0, row1, row2 = k * size + k, (k + 1) * size + k, (k + 2) * size + k
        t0, t1, t2 = _three_products(factors[row0 + 3 :], size, near[k + 3 : size], size - k - 3)
        c = (near[k + 2] - t2) / factors[row2 + 2]
        b = (near[k + 1] - t1 - factors[row1 + 2] * c) / factors[row1 + 1]
        a = (near[k] - t0 - factors[row0 + 1] * b - factors[row0 + 2] * c) / factors[row0]
        near[k], near[k + 1], near[k + 2] = a, b, c
    _copy(near, y, pivots)


@kernel
def _three_products(rows: FloatArray, stride: int, x: FloatArray, count: int) -> Row3:
    """Scalar products of x [count] with three rows; they are independent, so the processor overlaps them."""
    t0, t1, t2 = 0.0, 0.0, 0.0
    if count == 0:
        return t0, t1, t2
    r0, r1, r2 = rows[:count], rows[stride : stride + count], rows[2 * stride : 2 * stride + count]
    for j in range(count):
        t0 += r0[j] * x[j]
        t1 += r1[j] * x[j]
        t2 += r2[j] * x[j]
    return t0, t1, t2
