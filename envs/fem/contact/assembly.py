"""Contact forces and blocks of all candidate pairs: barrier, mollifier and friction, summed over pairs.

    E = (kappa / h^2) e(c) b(d)  and the friction force of `contact`, for each pair closer than d_hat      [J, N]

Another contact term adds to the forces and blocks of the modes in `_write_modes` (see `stencil` for what modes are).
"""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..algebra.mat3 import add_matrices, outer, scale_matrix, transpose
from ..algebra.vec3 import Vec3, dot, load, scale, subtract
from ..model.model import Model, Parameters
from ..solver.workspace import NO_MATRIX, PROJECTED_MATRIX, Workspace
from .barrier import barrier
from .broad_phase import Candidates
from .contact import Contact, Quad, contact_terms, sliding_directions, weighted_sum
from .distance import EDGE_EDGE, Coefficients, Sliding, closest_points
from .mollifier import mollifier, squared_cross_norm, squared_cross_norm_blocks, squared_cross_norm_gradient
from .stencil import (
    ALL_MODES,
    FIRST,
    PLAIN_MODES,
    SECOND,
    C,
    Target,
    U,
    V,
    add_blocks,
    add_forces,
    collect_nodes,
    set_mode_block,
    set_mode_force,
    set_point_weights,
)

FloatArray = NDArray[np.float64]


@large_kernel
def add_contacts(
    model: Model,
    candidates: Candidates,
    motion: FloatArray,
    y: FloatArray,
    y_start: FloatArray,
    prescribed_move: FloatArray,
    workspace: Workspace,
    matrix: int,
) -> None:
    """Add all pairs closer than d_hat at points y [m], with friction measured from points y_start [m].

    `motion` [k] bounds how far each pair of bodies has moved since the candidates were listed [m].
    """
    kinds, points, distances, bodies = candidates.kind, candidates.points, candidates.distance_m, candidates.bodies
    frictions, thresholds = candidates.friction, candidates.mollifier_eps_m4
    stencil, gradient = workspace.stencil, workspace.gradient
    weights, forces, jacobian = stencil.point_weights, stencil.force, stencil.jacobian
    d_hat = model.parameters.d_hat_m
    target = Target(
        model.system.block,
        model.system.neighbours,
        model.unknowns.slot,
        workspace.entries,
        workspace.gradient,
        workspace.coupling,
        prescribed_move,
    )
    smallest = np.inf
    active = 0
    for k in range(len(kinds)):
        if distances[k] - motion[bodies[k]] >= d_hat:
            continue
        p0, p1, p2, p3 = points[k, 0], points[k, 1], points[k, 2], points[k, 3]
        x = (load(y, p0), load(y, p1), load(y, p2), load(y, p3))
        c, sliding, r = closest_points(kinds[k], x[0], x[1], x[2], x[3])
        squared = dot(r, r)
        if squared >= d_hat * d_hat:
            continue
        d = np.sqrt(squared)
        smallest = min(smallest, d)
        active += 1
        moves = (
            subtract(x[0], load(y_start, p0)),
            subtract(x[1], load(y_start, p1)),
            subtract(x[2], load(y_start, p2)),
            subtract(x[3], load(y_start, p3)),
        )
        modes = _write_modes(
            model.parameters,
            frictions[k],
            thresholds[k],
            x,
            moves,
            c,
            sliding,
            d,
            r,
            weights,
            forces,
            jacobian,
            matrix,
        )
        split = 2 if kinds[k] == EDGE_EDGE else 1
        count = collect_nodes(model.points, points, k, split, modes, stencil)
        add_forces(stencil, count, modes, gradient)
        if matrix != NO_MATRIX:
            add_blocks(stencil, count, PLAIN_MODES if matrix == PROJECTED_MATRIX else modes, target)
    workspace.smallest[0] = smallest
    workspace.active[0] = active


@kernel
def _write_modes(
    parameters: Parameters,
    friction: float,
    mollifier_eps: float,
    x: Quad,
    moves: Quad,
    c: Coefficients,
    sliding: Sliding,
    d: float,
    r: Vec3,
    weights: FloatArray,
    forces: FloatArray,
    jacobian: FloatArray,
    matrix: int,
) -> int:
    """Write weights, forces and blocks of a contact's modes; returns their number.

    Args:
        parameters: of contact.
        friction: friction coefficient.
        mollifier_eps: threshold of the mollifier [m^4]; 0 for pairs without.
        x: points [m].
        moves: their displacements in the step [m].
        c: coefficients of the closest points.
        sliding: which coefficients can move.
        d: distance [m].
        r: separation [m].
        weights: of the points in the modes; written, like the next two.
        forces: on the modes [N].
        jacobian: of the modes [N/m].
        matrix: which one is asked for.
    """
    kappa = parameters.barrier_stiffness_n_m
    n = scale(1.0 / d, r)
    b, b_first, b_second = barrier(d, parameters.d_hat_m)
    e, e_first, e_second = 1.0, 0.0, 0.0
    u, v = subtract(x[1], x[0]), subtract(x[3], x[2])
    if mollifier_eps > 0.0:
        e, e_first, e_second = mollifier(squared_cross_norm(u, v), mollifier_eps)
    first, second = sliding_directions(sliding, x, moves)
    contact = contact_terms(
        d,
        n,
        weighted_sum(c, moves),
        -kappa * e * b_first,
        kappa * e * b_second,
        friction,
        parameters.slip_scale_m,
        first,
        second,
        matrix == PROJECTED_MATRIX,
    )
    set_point_weights(weights, C, c)
    set_point_weights(weights, FIRST, first.dc)
    set_point_weights(weights, SECOND, second.dc)
    set_mode_force(forces, C, contact.force)
    if matrix != NO_MATRIX:
        _write_plain_blocks(contact, first.tangent, second.tangent, n, d, jacobian)
    if e == 1.0:
        return PLAIN_MODES
    _write_mollifier(
        contact,
        u,
        v,
        n,
        kappa * b * e_first,
        kappa * b_first * e_first,
        kappa * b * e_second,
        weights,
        forces,
        jacobian,
    )
    return ALL_MODES


@kernel
def _write_plain_blocks(
    contact: Contact, tangent0: Vec3, tangent1: Vec3, n: Vec3, d: float, jacobian: FloatArray
) -> None:
    """Write base and left_k v_k^T of `contact`, sorted by the modes they act between."""
    lean0, lean1 = scale(1.0 / d, tangent0), scale(1.0 / d, tangent1)
    left0, left1, left_dc = contact.left_c[0], contact.left_c[1], contact.left_dc
    bent = add_matrices(outer(left0, lean0), outer(left1, lean1))
    zero = scale_matrix(0.0, bent)
    set_mode_block(jacobian, C, C, add_matrices(contact.base, bent))
    set_mode_block(jacobian, C, FIRST, outer(left0, n))
    set_mode_block(jacobian, C, SECOND, outer(left1, n))
    set_mode_block(jacobian, FIRST, C, outer(left_dc, lean0))
    set_mode_block(jacobian, FIRST, FIRST, outer(left_dc, n))
    set_mode_block(jacobian, FIRST, SECOND, zero)
    set_mode_block(jacobian, SECOND, C, outer(left_dc, lean1))
    set_mode_block(jacobian, SECOND, FIRST, zero)
    set_mode_block(jacobian, SECOND, SECOND, outer(left_dc, n))


@kernel
def _write_mollifier(
    contact: Contact,
    u: Vec3,
    v: Vec3,
    n: Vec3,
    slope: float,
    force_rate: float,
    curvature: float,
    weights: FloatArray,
    forces: FloatArray,
    jacobian: FloatArray,
) -> None:
    """Write the derivatives of the mollifier e(c) in the energy B e(c), B = (kappa / h^2) b.

    Force on the edge vectors: slope grad c, slope = B e'. Blocks: the barrier's and friction's change with c, rate
    (grad c)^T; force_rate grad c n^T with force_rate = dB/dd e'; and curvature grad c grad c^T + slope hessian c with
    curvature = B e''. The blocks between them and sliding directions are never written and stay zero.
    """
    gu, gv = squared_cross_norm_gradient(u, v)
    uu, uv, vv = squared_cross_norm_blocks(u, v)
    rate = scale(force_rate, subtract(n, contact.phi_per_newton))
    set_point_weights(weights, U, (-1.0, 1.0, 0.0, 0.0))
    set_point_weights(weights, V, (0.0, 0.0, -1.0, 1.0))
    set_mode_force(forces, U, scale(slope, gu))
    set_mode_force(forces, V, scale(slope, gv))
    set_mode_block(jacobian, C, U, outer(rate, gu))
    set_mode_block(jacobian, C, V, outer(rate, gv))
    set_mode_block(jacobian, U, C, scale_matrix(force_rate, outer(gu, n)))
    set_mode_block(jacobian, V, C, scale_matrix(force_rate, outer(gv, n)))
    set_mode_block(jacobian, U, U, add_matrices(scale_matrix(curvature, outer(gu, gu)), scale_matrix(slope, uu)))
    set_mode_block(jacobian, U, V, add_matrices(scale_matrix(curvature, outer(gu, gv)), scale_matrix(slope, uv)))
    set_mode_block(
        jacobian, V, U, add_matrices(scale_matrix(curvature, outer(gv, gu)), scale_matrix(slope, transpose(uv)))
    )
    set_mode_block(jacobian, V, V, add_matrices(scale_matrix(curvature, outer(gv, gv)), scale_matrix(slope, vv)))
