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

from ...compilation import kernel
from ..algebra import Mat3, Vec3, add_sum_of_two, write_sum_of_three
from ..linear.system import GEL_STRIDE, NO_PLACE, block_place, gel_block_place
from ..model.model import PRESCRIBED, Model, NewtonSystem, Points
from .distance import Coefficients
from .features import Terms, new_terms

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
    flat_weights: FloatArray  # the same numbers
    terms: Terms  # that a pair stands for
    force: FloatArray  # [5, 3] on the modes [N]
    jacobian: FloatArray  # [15, 15] of the modes [N/m]
    rows: FloatArray  # of the modes by the nodes [N/m]: component r by k of node j at 8 (3 r + k) + j
    block: FloatArray  # of the nodes [N/m]: component k of node i by m of node j at 8 (3 (3 i + k) + m) + j


def new_stencil() -> Stencil:
    """Return uninitialised scratch."""
    flat_weights = np.zeros(ALL_MODES * _NODES)
    return Stencil(
        point_weights=np.empty((ALL_MODES, 4)),
        nodes=np.empty(_NODES, dtype=np.int64),
        weights=flat_weights.reshape(ALL_MODES, _NODES),
        flat_weights=flat_weights,
        terms=new_terms(),
        force=np.empty((ALL_MODES, 3)),
        jacobian=np.zeros((3 * ALL_MODES, 3 * ALL_MODES)),
        rows=np.empty(3 * ALL_MODES * 3 * _NODES),
        block=np.empty(3 * _NODES * 3 * _NODES),
    )


@kernel
def set_point_weights(weights: FloatArray, mode: int, w: Coefficients) -> None:
    """Set the weights of the contact's four points in a mode, in `Stencil.point_weights`."""
    weights[mode, 0], weights[mode, 1], weights[mode, 2], weights[mode, 3] = w


@kernel
def set_mode_force(forces: FloatArray, mode: int, force: Vec3) -> None:
    """Set the force on a mode [N], in `Stencil.force`."""
    forces[mode, 0], forces[mode, 1], forces[mode, 2] = force


@kernel
def set_mode_block(jacobian: FloatArray, mode: int, by: int, block: Mat3) -> None:
    """Set the derivative of the force on a mode by another [N/m], given by its rows, in `Stencil.jacobian`."""
    i, j = 3 * mode, 3 * by
    jacobian[i, j], jacobian[i, j + 1], jacobian[i, j + 2] = block[0]
    jacobian[i + 1, j], jacobian[i + 1, j + 1], jacobian[i + 1, j + 2] = block[1]
    jacobian[i + 2, j], jacobian[i + 2, j + 1], jacobian[i + 2, j + 2] = block[2]


@kernel
def collect_nodes(points: Points, pairs: IndexArray, pair: int, split: int, modes: int, stencil: Stencil) -> int:
    """Write the nodes and weights of a pair [k, 4] whose second side begins at point `split`; returns their number."""
    node_count, point_nodes, point_weights = points.node_count, points.nodes, points.weights
    given, nodes, weights = stencil.point_weights, stencil.nodes, stencil.weights
    count = 0
    for side in range(2):
        low, high = (0, split) if side == 0 else (split, 4)
        first = pairs[pair, low]
        if node_count[first] == 1:
            for i in range(low, high):
                # A node without weight, like the far corner of a triangle touched at an edge, is left out.
                used = False
                for t in range(modes):
                    weights[t, count] = given[t, i]
                    used = used or given[t, i] != 0.0
                if used:
                    nodes[count] = point_nodes[pairs[pair, i], 0]
                    count += 1
        else:
            for k in range(_FRAME_POINTS):
                nodes[count + k] = point_nodes[first, k]
                for t in range(modes):
                    total = 0.0
                    for i in range(low, high):
                        total += given[t, i] * point_weights[pairs[pair, i], k]
                    weights[t, count + k] = total
            count += _FRAME_POINTS
    return count


@kernel
def add_forces(stencil: Stencil, count: int, modes: int, gradient: FloatArray) -> None:
    """Add sum_t w_ti f_t to the nodes; of the plain modes only C carries a force."""
    nodes, weights, force = stencil.nodes, stencil.weights, stencil.force
    for i in range(count):
        node = nodes[i]
        for k in range(3):
            total = weights[C, i] * force[C, k]
            if modes == ALL_MODES:
                total += weights[U, i] * force[U, k] + weights[V, i] * force[V, k]
            gradient[node, k] += total


@kernel
def add_blocks(stencil: Stencil, count: int, modes: int, model: Model, system: NewtonSystem) -> None:
    """Add the blocks of all pairs of a contact's nodes to the matrix, and those of prescribed ones to the coupling."""
    _expand(stencil, count, modes)
    nodes, block, entries, slot, layout = (
        stencil.nodes,
        stencil.block,
        system.entries,
        model.unknowns.slot,
        model.system,
    )
    start, neighbour = layout.neighbours
    for i in range(count):
        a = slot[nodes[i]]
        if a == PRESCRIBED:
            continue
        j = 0
        while j < count:
            b = slot[nodes[j]]
            if b == PRESCRIBED:
                _add_coupling(stencil, i, j, system)
                j += 1
            elif b >= layout.block.nodes:
                place, stride = block_place(layout.block, a, b)
                _add_frame_run(block, i, j, entries, place, stride)
                j += _FRAME_POINTS
            else:
                within = a < layout.block.nodes
                place = gel_block_place(start, neighbour, a, b) if within else block_place(layout.block, a, b)[0]
                if place == NO_PLACE:
                    _add_bound(
                        block, i, j, entries, block_place(layout.block, a, a)[0], block_place(layout.block, b, b)[0]
                    )
                else:
                    _add_gel_block(block, i, j, entries, place)
                j += 1


@kernel
def _expand(stencil: Stencil, count: int, modes: int) -> None:
    """Write rows = H w and block = w^T rows, for all eight places of nodes at once, of which `count` are used."""
    weights, jacobian, rows, block = stencil.weights, stencil.jacobian, stencil.rows, stencil.block
    w, n = stencil.flat_weights, _NODES
    for r in range(3 * modes):
        for k in range(3):
            H, place = jacobian, n * (3 * r + k)
            write_sum_of_three(rows, place, (H[r, k], H[r, 3 + k], H[r, 6 + k]), w, (C * n, FIRST * n, SECOND * n))
            if modes == ALL_MODES:
                add_sum_of_two(rows, place, (H[r, 9 + k], H[r, 12 + k]), w, (U * n, V * n))
    for i in range(count):
        w012, w34 = (weights[C, i], weights[FIRST, i], weights[SECOND, i]), (weights[U, i], weights[V, i])
        for k in range(9):
            place, row = n * (9 * i + k), n * k
            write_sum_of_three(block, place, w012, rows, (row, row + 9 * n, row + 18 * n))
            if modes == ALL_MODES:
                add_sum_of_two(block, place, w34, rows, (row + 27 * n, row + 36 * n))


@kernel
def _entry(i: int, k: int, j: int, m: int) -> int:
    """Return the place in `Stencil.block` of component k of node i by component m of node j."""
    return _NODES * (3 * (3 * i + k) + m) + j


@kernel
def _add_gel_block(block: FloatArray, i: int, j: int, entries: FloatArray, place: int) -> None:
    for k in range(3):
        for m in range(3):
            entries[place + k * GEL_STRIDE + m] += block[_entry(i, k, j, m)]


@kernel
def _add_frame_run(block: FloatArray, i: int, j: int, entries: FloatArray, place: int, stride: int) -> None:
    """Add the blocks of a body's four frame points, whose columns adjoin."""
    for k in range(3):
        for p in range(_FRAME_POINTS):
            for m in range(3):
                entries[place + k * stride + 3 * p + m] += block[_entry(i, k, j + p, m)]


@kernel
def _add_coupling(stencil: Stencil, i: int, j: int, system: NewtonSystem) -> None:
    """Add what the prescribed motion of node j does to node i."""
    block, coupling, node = stencil.block, system.coupling, stencil.nodes[i]
    move, other = system.prescribed_move, stencil.nodes[j]
    for k in range(3):
        for m in range(3):
            coupling[node, k] += block[_entry(i, k, j, m)] * move[other, m]


@kernel
def _add_bound(block: FloatArray, i: int, j: int, entries: FloatArray, of_a: int, of_b: int) -> None:
    """Replace a coupling outside the pattern, of gels that meet within a step, by a bound that slows convergence."""
    for k in range(3):
        for m in range(3):
            half = 0.5 * abs(block[_entry(i, k, j, m)])
            entries[of_a + k * (GEL_STRIDE + 1)] += half
            entries[of_b + m * (GEL_STRIDE + 1)] += half
