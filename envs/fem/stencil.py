"""From a contact's own variables to the nodes of the scene: forces and Jacobian blocks of one contact.

A contact knows the scene's nodes through a few *modes*, weighted sums sum_j w_tj x_j of the nodes j that it touches:
its separation (mode C), what its two sliding directions move (FIRST and SECOND), and the two edge vectors of a nearly
parallel edge pair (U and V). With f_t the force on mode t and H_ts its derivative by mode s,

    force on node i = sum_t w_ti f_t,     block of nodes i and j = sum_ts w_ti H_ts w_sj

`contact` writes f and H; a point of an affine body hands its weights on to the body's four frame points.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from .distance import Coefficients
from .linear_solve import BlockLayout, block_place
from .mat3 import Mat3
from .model import PRESCRIBED, Points
from .vec3 import Vec3

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

C, FIRST, SECOND, U, V = 0, 1, 2, 3, 4
# Modes of a plain contact, and with those of the mollifier.
PLAIN_MODES, ALL_MODES = 3, 5
_FRAME_POINTS = 4
_NODES = 2 * _FRAME_POINTS


class Stencil(NamedTuple):
    """Scratch for one contact."""

    point_weights: FloatArray  # [5, 4] weights of the contact's points in the modes
    nodes: IndexArray  # [8]
    weights: FloatArray  # [5, 8] weights of the nodes in the modes
    force: FloatArray  # [5, 3] on the modes [N]
    jacobian: FloatArray  # [15, 15] of the modes [N/m]
    rows: FloatArray  # [15, 24] of the modes by the nodes [N/m]
    block: FloatArray  # [24, 24] of the nodes [N/m]


class Target(NamedTuple):
    """Where a contact's forces and blocks go."""

    system: BlockLayout
    slot: IndexArray  # [n] unknown of a node, or PRESCRIBED
    entries: FloatArray
    gradient: FloatArray  # [n, 3]
    coupling: FloatArray  # [n, 3]
    prescribed_move: FloatArray  # [n, 3]


def new_stencil() -> Stencil:
    """Uninitialised scratch."""
    return Stencil(
        point_weights=np.empty((ALL_MODES, 4)),
        nodes=np.empty(_NODES, dtype=np.int64),
        weights=np.empty((ALL_MODES, _NODES)),
        force=np.empty((ALL_MODES, 3)),
        jacobian=np.zeros((3 * ALL_MODES, 3 * ALL_MODES)),
        rows=np.empty((3 * ALL_MODES, 3 * _NODES)),
        block=np.empty((3 * _NODES, 3 * _NODES)),
    )


@kernel
def set_point_weights(stencil: Stencil, mode: int, w: Coefficients) -> None:
    """Set the weights of the contact's four points in a mode."""
    weights = stencil.point_weights
    weights[mode, 0], weights[mode, 1], weights[mode, 2], weights[mode, 3] = w


@kernel
def set_mode_force(stencil: Stencil, mode: int, force: Vec3) -> None:
    """Set the force on a mode [N]."""
    stencil.force[mode, 0], stencil.force[mode, 1], stencil.force[mode, 2] = force


@kernel
def set_mode_block(stencil: Stencil, mode: int, by: int, block: Mat3) -> None:
    """Set the derivative of the force on a mode by another mode [N/m], given by its rows."""
    for k in range(3):
        row = stencil.jacobian[3 * mode + k]
        row[3 * by], row[3 * by + 1], row[3 * by + 2] = block[k]


@kernel
def collect_nodes(points: Points, corners: IndexArray, split: int, modes: int, stencil: Stencil) -> int:
    """Write the nodes and weights of a contact whose second side begins at corner `split`; returns their number."""
    count = _collect_side(points, corners, 0, split, modes, stencil, 0)
    return _collect_side(points, corners, split, 4, modes, stencil, count)


@kernel
def _collect_side(
    points: Points, corners: IndexArray, low: int, high: int, modes: int, stencil: Stencil, count: int
) -> int:
    """Append one side; a gel node without weight (the far corner of a triangle touched at an edge) is left out."""
    first = corners[low]
    if points.node_count[first] == 1:
        for i in range(low, high):
            used = False
            for t in range(modes):
                weight = stencil.point_weights[t, i]
                stencil.weights[t, count] = weight
                used = used or weight != 0.0
            if used:
                stencil.nodes[count] = points.nodes[corners[i], 0]
                count += 1
        return count
    for k in range(_FRAME_POINTS):
        stencil.nodes[count + k] = points.nodes[first, k]
        for t in range(modes):
            total = 0.0
            for i in range(low, high):
                total += stencil.point_weights[t, i] * points.weights[corners[i], k]
            stencil.weights[t, count + k] = total
    return count + _FRAME_POINTS


@kernel
def add_forces(stencil: Stencil, count: int, modes: int, gradient: FloatArray) -> None:
    """Add sum_t w_ti f_t to the nodes; of the plain modes only C carries a force."""
    for i in range(count):
        node, w = stencil.nodes[i], stencil.weights[C, i]
        for k in range(3):
            total = w * stencil.force[C, k]
            if modes == ALL_MODES:
                total += stencil.weights[U, i] * stencil.force[U, k] + stencil.weights[V, i] * stencil.force[V, k]
            gradient[node, k] += total


@kernel
def add_blocks(stencil: Stencil, count: int, modes: int, target: Target) -> None:
    """Add the blocks of all pairs of a contact's nodes to the system, and those of prescribed ones to the coupling."""
    _expand(stencil.weights, stencil.jacobian, count, modes, stencil.rows, stencil.block)
    nodes, block, entries, slot, system = stencil.nodes, stencil.block, target.entries, target.slot, target.system
    for i in range(count):
        a = slot[nodes[i]]
        if a == PRESCRIBED:
            continue
        j = 0
        while j < count:
            b = slot[nodes[j]]
            if b == PRESCRIBED:
                _add_coupling(block, i, j, target.coupling, nodes[i], target.prescribed_move, nodes[j])
                j += 1
            elif 3 * b >= system.n:
                place, stride = block_place(system, a, b)
                _add_frame_run(block, 3 * i, 3 * j, entries, place, stride)
                j += _FRAME_POINTS
            else:
                if max(a, b) < system.n // 3 and abs(a - b) > system.band_width:
                    _add_bound(block, i, j, entries, block_place(system, a, a), block_place(system, b, b))
                else:
                    place, stride = block_place(system, a, b)
                    _add_gel_block(block, 3 * i, 3 * j, entries, place, stride)
                j += 1


@kernel
def _expand(
    weights: FloatArray, jacobian: FloatArray, count: int, modes: int, rows: FloatArray, block: FloatArray
) -> None:
    """Write rows = H w, shape [3 modes, 3 count], and block = w^T rows, shape [3 count, 3 count]."""
    for r in range(3 * modes):
        for j in range(count):
            w0, w1, w2 = weights[C, j], weights[FIRST, j], weights[SECOND, j]
            for k in range(3):
                rows[r, 3 * j + k] = w0 * jacobian[r, k] + w1 * jacobian[r, 3 + k] + w2 * jacobian[r, 6 + k]
            if modes == ALL_MODES:
                w3, w4 = weights[U, j], weights[V, j]
                for k in range(3):
                    rows[r, 3 * j + k] += w3 * jacobian[r, 9 + k] + w4 * jacobian[r, 12 + k]
    for i in range(count):
        w0, w1, w2 = weights[C, i], weights[FIRST, i], weights[SECOND, i]
        for k in range(3):
            row, row0, row1, row2 = block[3 * i + k], rows[k], rows[3 + k], rows[6 + k]
            for column in range(3 * count):
                row[column] = w0 * row0[column] + w1 * row1[column] + w2 * row2[column]
            if modes == ALL_MODES:
                w3, w4, row3, row4 = weights[U, i], weights[V, i], rows[9 + k], rows[12 + k]
                for column in range(3 * count):
                    row[column] += w3 * row3[column] + w4 * row4[column]


@kernel
def _add_gel_block(block: FloatArray, row: int, column: int, entries: FloatArray, place: int, stride: int) -> None:
    for k in range(3):
        for m in range(3):
            entries[place + k * stride + m] += block[row + k, column + m]


@kernel
def _add_frame_run(block: FloatArray, row: int, column: int, entries: FloatArray, place: int, stride: int) -> None:
    """Add the blocks of a body's four frame points, whose columns adjoin."""
    for k in range(3):
        into = entries[place + k * stride : place + k * stride + 3 * _FRAME_POINTS]
        source = block[row + k, column : column + 3 * _FRAME_POINTS]
        for m in range(3 * _FRAME_POINTS):
            into[m] += source[m]


@kernel
def _add_coupling(
    block: FloatArray, i: int, j: int, coupling: FloatArray, node: int, prescribed_move: FloatArray, other: int
) -> None:
    """Add what the prescribed motion of another node does to a node."""
    for k in range(3):
        for m in range(3):
            coupling[node, k] += block[3 * i + k, 3 * j + m] * prescribed_move[other, m]


@kernel
def _add_bound(
    block: FloatArray, i: int, j: int, entries: FloatArray, of_a: tuple[int, int], of_b: tuple[int, int]
) -> None:
    """Replace a coupling outside the band (two gels that touch) by a bound on it, which only slows convergence."""
    for k in range(3):
        for m in range(3):
            half = 0.5 * abs(block[3 * i + k, 3 * j + m])
            entries[of_a[0] + k * (of_a[1] + 1)] += half
            entries[of_b[0] + m * (of_b[1] + 1)] += half
