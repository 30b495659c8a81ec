"""Solves the Newton system by multifrontal elimination (Duff & Reid, ACM TOMS 1983), unsymmetric, without exchanges.

Friction makes the matrix unsymmetric, but its pattern is symmetric and it stays close to a symmetric positive definite
one, so Gaussian elimination needs no row exchanges: which rows meet is known before any number is. Every front is a
small dense matrix, of which the three rows of a node are the unit of work.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..algebra import LANES, subtract_products
from .system import BlockLayout, Fronts, SystemLayout

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
    front: FloatArray  # the front at work
    stack: FloatArray  # what fronts have passed on
    inverse_pivots: FloatArray  # [w] of the front at work
    near: FloatArray  # [w] solution at the rows of a front


def new_factor(system: SystemLayout) -> Factor:
    """Return the arrays for the factors of a system of this layout."""
    fronts = system.fronts
    return Factor(
        entries=np.empty(fronts.factors),
        negative_pivots=np.zeros(1, dtype=np.int64),
        front=_aligned(fronts.widest * _stride(fronts.widest)),
        stack=np.empty(fronts.stack),
        inverse_pivots=np.empty(fronts.widest),
        near=np.empty(fronts.widest),
    )


class Front(NamedTuple):
    """The front at work: a square matrix whose rows begin where eight lanes do."""

    rows: FloatArray  # row by row; what a row has beyond its columns is never used
    stride: int  # from row to row
    size: int  # rows, and columns
    pivots: int


def _aligned(size: int) -> FloatArray:
    """Return uninitialised numbers from a multiple of eight lanes' bytes on, so that no lanes cross a cache line."""
    room = np.empty(size + LANES)
    return room[-(room.ctypes.data // room.itemsize) % LANES :][:size]


@kernel
def _stride(size: int) -> int:
    return (size + LANES - 1) // LANES * LANES


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
        stride = _stride(size)
        front = Front(factor.front[: size * stride], stride, size, pivots)
        front.rows[:] = 0.0
        _load(system.block, system.neighbours.start, fronts, f, entries, front)
        for c in range(fronts.child_start[f], fronts.child_start[f + 1]):
            _add_child(fronts, fronts.children[c], factor.stack, front)
        if not _eliminate(front, factor.inverse_pivots, factor.negative_pivots, positive):
            return False
        _store(front, factor.entries[fronts.factor[f] :], factor.stack[fronts.passed[f] :])
    return True


@kernel
def has_negative_determinant(factor: Factor) -> bool:
    """Return whether the determinant of a factorised matrix, the product of its pivots, is negative."""
    return bool(factor.negative_pivots[0] % 2 == 1)


@large_kernel
def substitute(system: SystemLayout, factor: Factor, x: FloatArray) -> None:
    """Solve with the factors, in place: x [n + m] is the right-hand side, then the solution."""
    fronts = system.fronts
    for f in range(len(fronts.factor)):
        _substitute_forward(fronts, f, factor.entries[fronts.factor[f] :], x)
    for f in range(len(fronts.factor) - 1, -1, -1):
        _substitute_back(fronts, f, factor.entries[fronts.factor[f] :], x, factor.near)


@large_kernel
def negative_curvature_direction(system: SystemLayout, factor: Factor, x: FloatArray) -> None:
    """Write an x [n + m] with x A x < 0 for a factorised matrix A with a negative pivot; zeros if it has none.

    The unknown of the last such pivot is 1, those eliminated later are 0 and those before it free of forces, so that
    x A x is the pivot (Gill, Murray & Wright, Practical Optimization, 1981, section 4.4.2.2, for a symmetric A).
    """
    fronts = system.fronts
    x[:] = 0.0
    found = False
    for f in range(len(fronts.factor) - 1, -1, -1):
        factors = factor.entries[fronts.factor[f] :]
        if not found:
            found = _mark_last_negative_pivot(fronts, f, factors, x)
        if found:
            _substitute_back(fronts, f, factors, x, factor.near)


@kernel
def _mark_last_negative_pivot(fronts: Fronts, f: int, factors: FloatArray, x: FloatArray) -> bool:
    """Write the right-hand side of the triangular system whose solution is 1 at that unknown, if a front has one."""
    pivots = 3 * (fronts.first[f + 1] - fronts.first[f])
    size = pivots + 3 * (fronts.row_start[f + 1] - fronts.row_start[f])
    for k in range(pivots - 1, -1, -1):
        pivot = factors[k * size + k]
        if pivot < 0.0:
            x[3 * fronts.first[f] + k] = pivot
            return True
    return False


@kernel
def _load(block: BlockLayout, start: IndexArray, fronts: Fronts, f: int, entries: FloatArray, front: Front) -> None:
    """Write the matrix's own blocks in the rows and columns of the front's pivots."""
    first, stop, n, m = fronts.first[f], fronts.first[f + 1], block.nodes, block.m
    rows, stride, border = front.rows, front.stride, front.size - m
    if first == n:
        for row in range(m):
            _copy(entries[block.corner + row * m :], rows[row * stride :], m)
        return
    for a in range(first, stop):
        i = a - first
        _put(entries, 9 * a, rows, 3 * i * stride + 3 * i, stride)
        for k in range(start[a], start[a + 1]):
            j = fronts.local[k]
            if j >= 0:
                _put(entries, 9 * (n + k), rows, 3 * i * stride + 3 * j, stride)
                if j >= stop - first:
                    _put(entries, 9 * (n + fronts.mirrored[k]), rows, 3 * j * stride + 3 * i, stride)
        for row in range(3):
            _copy(entries[block.right + (3 * a + row) * m :], rows[(3 * i + row) * stride + border :], m)
        for row in range(0, m, 3):
            _put(entries, block.bottom + 3 * (m * a + row), rows, (border + row) * stride + 3 * i, stride)


@kernel
def _put(entries: FloatArray, source: int, rows: FloatArray, place: int, stride: int) -> None:
    block = entries[source : source + 9]
    r0, r1, r2 = (
        rows[place : place + 3],
        rows[place + stride : place + stride + 3],
        rows[place + 2 * stride : place + 2 * stride + 3],
    )
    r0[0], r0[1], r0[2] = block[0], block[1], block[2]
    r1[0], r1[1], r1[2] = block[3], block[4], block[5]
    r2[0], r2[1], r2[2] = block[6], block[7], block[8]


@kernel
def _copy(source: FloatArray, target: FloatArray, count: int) -> None:
    for i in range(count):
        target[i] = source[i]


@kernel
def _add_child(fronts: Fronts, child: int, stack: FloatArray, front: Front) -> None:
    """Add what a child has passed on."""
    slot = fronts.slot[fronts.row_start[child] : fronts.row_start[child + 1]]
    width = 3 * len(slot)
    place = fronts.passed[child]
    for i in range(len(slot)):
        for row in range(3):
            passed = stack[place : place + width]
            target = front.rows[(3 * slot[i] + row) * front.stride : (3 * slot[i] + row + 1) * front.stride]
            for j in range(len(slot)):
                column = 3 * slot[j]
                target[column] += passed[3 * j]
                target[column + 1] += passed[3 * j + 1]
                target[column + 2] += passed[3 * j + 2]
            place += width


@kernel
def _eliminate(front: Front, inverse_pivots: FloatArray, negative_pivots: IndexArray, positive: bool) -> bool:
    """Eliminate the pivots; multipliers take the place of what they eliminate.

    A panel of pivot rows stays in the cache while all rows below pass by; the size of panels changes no bit.
    """
    for start in range(0, front.pivots, _PANEL_ROWS):
        stop = min(start + _PANEL_ROWS, front.pivots)
        for i in range(start, front.size, 3):
            end = min(i, stop)
            for k in range(start, end - 3, 6):
                _eliminate_two_nodes(front, i, k, inverse_pivots)
            if (end - start) % 6:
                _eliminate_node(front, i, end - 3, inverse_pivots)
            if i < stop and not _eliminate_within_node(front, i, inverse_pivots, negative_pivots, positive):
                return False
    return True


@kernel
def _eliminate_node(front: Front, i: int, k: int, inverse_pivots: FloatArray) -> None:
    """Eliminate the pivots of the node at row k from the three rows at i."""
    rows, stride = front.rows, front.stride
    u, r = k * stride, i * stride
    factors = _row_multipliers(rows, r + k, u + k, stride, inverse_pivots, k)
    first = (k + 3) // LANES * LANES
    subtract_products(rows, (r + first, u + first, stride, k + 3 - first), factors)  # type: ignore[call-arg]
    for j in range(first + LANES, front.size, LANES):
        subtract_products(rows, (r + j, u + j, stride, 0), factors)


@kernel
def _eliminate_two_nodes(front: Front, i: int, k: int, inverse_pivots: FloatArray) -> None:
    """Eliminate the pivots of the two nodes from row k on: where the time of large systems goes.

    Each number is what two calls of `_eliminate_node` would make of it, but is read and written once.
    """
    rows, stride = front.rows, front.stride
    u, r, following = k * stride, i * stride, (k + 3) * stride
    factors = _row_multipliers(rows, r + k, u + k, stride, inverse_pivots, k)
    for row in range(3):
        f, at = factors[row], r + row * stride
        for j in range(k + 3, k + 6):
            rows[at + j] -= f[0] * rows[u + j] + f[1] * rows[u + stride + j] + f[2] * rows[u + 2 * stride + j]
    further = _row_multipliers(rows, r + k + 3, following + k + 3, stride, inverse_pivots, k + 3)
    first, both = (k + 6) // LANES * LANES, (*factors, *further)
    subtract_products(rows, (r + first, u + first, stride, k + 6 - first), both)  # type: ignore[call-arg]
    for j in range(first + LANES, front.size, LANES):
        subtract_products(rows, (r + j, u + j, stride, 0), both)


@kernel
def _eliminate_within_node(
    front: Front, k: int, inverse_pivots: FloatArray, negative_pivots: IndexArray, positive: bool
) -> bool:
    """Eliminate a node's own three pivots from each other's rows and write their inverses."""
    u, stride, width = k * (front.stride + 1), front.stride, front.size - k
    u0, u1, u2 = (
        front.rows[u : u + width],
        front.rows[u + stride : u + stride + width],
        front.rows[u + 2 * stride : u + 2 * stride + width],
    )
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
def _row_multipliers(
    rows: FloatArray, r: int, u: int, stride: int, inverse_pivots: FloatArray, k: int
) -> tuple[Row3, Row3, Row3]:
    """Write and return the multipliers of three rows, see `_multipliers`."""
    return (
        _multipliers(rows, r, u, stride, inverse_pivots, k),
        _multipliers(rows, r + stride, u, stride, inverse_pivots, k),
        _multipliers(rows, r + 2 * stride, u, stride, inverse_pivots, k),
    )


@kernel
def _multipliers(rows: FloatArray, r: int, u: int, stride: int, inverse_pivots: FloatArray, k: int) -> Row3:
    """Write and return the multipliers that eliminate three entries from r on, by the pivots k with rows from u on."""
    f0 = rows[r] * inverse_pivots[k]
    f1 = (rows[r + 1] - f0 * rows[u + 1]) * inverse_pivots[k + 1]
    f2 = (rows[r + 2] - f0 * rows[u + 2] - f1 * rows[u + stride + 2]) * inverse_pivots[k + 2]
    rows[r], rows[r + 1], rows[r + 2] = f0, f1, f2
    return f0, f1, f2


@kernel
def _store(front: Front, factors: FloatArray, passed: FloatArray) -> None:
    """Keep the factors, and pass the rest on."""
    size, pivots, left = front.size, front.pivots, front.size - front.pivots
    for i in range(size):
        row = front.rows[i * front.stride : (i + 1) * front.stride]
        if i < pivots:
            _copy(row, factors[i * size :], size)
        else:
            _copy(row, factors[pivots * (left + i) :], pivots)
            _copy(row[pivots:], passed[(i - pivots) * left :], left)


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
    """Return the scalar products of x [count] with three rows; they are independent, so the processor overlaps them."""
    t0, t1, t2 = 0.0, 0.0, 0.0
    if count == 0:
        return t0, t1, t2
    r0, r1, r2 = rows[:count], rows[stride : stride + count], rows[2 * stride : 2 * stride + count]
    for j in range(count):
        t0 += r0[j] * x[j]
        t1 += r1[j] * x[j]
        t2 += r2[j] * x[j]
    return t0, t1, t2
