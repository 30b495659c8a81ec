"""Contact forces and blocks of all candidate pairs: barrier, mollifier and friction, summed over pairs.

    E = (kappa / h^2) e(c) b(d)  and the friction force of `contact`, for each pair closer than d_hat      [J, N]

Where each place of a surface counts once, a pair stands for the distances that `features` writes, each with a factor.

Another contact term adds to the forces and blocks of the modes in `_write_modes` (see `stencil` for what modes are).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..algebra import Vec3, add, add_matrices, dot, load, outer, scale, scale_matrix, subtract, transpose
from ..model.model import EXACT_MATRIX, NO_MATRIX, PROJECTED_MATRIX, Model, NewtonSystem, Parameters
from .barrier import (
    barrier,
    drag,
    mollifier,
    squared_cross_norm,
    squared_cross_norm_blocks,
    squared_cross_norm_gradient,
    update_dual,
)
from .broad_phase import Candidates
from .contact import Contact, ContactGeometry, Friction, NormalForce, contact_geometry, contact_terms, weighted_sum
from .distance import EDGE_EDGE, NO_SLIDING, POINT_TRIANGLE, closest_points
from .features import separation, write_terms
from .forces import NO_SLIP, ContactMemory, recall_slip
from .stencil import (
    ALL_MODES,
    FIRST,
    PLAIN_MODES,
    SECOND,
    C,
    Stencil,
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

_NO_DUAL = -1


class PointState(NamedTuple):
    """Surface points at a state."""

    y: FloatArray  # [p, 3] [m]
    y_start: FloatArray  # [p, 3] at the start of the step, from where friction is measured [m]
    motion: FloatArray  # [k] largest motion of each pair of bodies since the candidates were listed [m]
    memory: ContactMemory  # of the start of the step


class PairProperties(NamedTuple):
    """What a candidate carries beside its points."""

    factor: float  # how often it counts
    friction_coefficient: float
    mollifier_eps_m4: float  # threshold of the mollifier; 0 for pairs without
    dual_row: int  # of its dual variable of friction, or _NO_DUAL
    slip_m: Vec3  # w of `contact`


class MollifierRates(NamedTuple):
    """Derivatives of B e(c), B = (kappa / h^2) b(d), c the squared cross norm of the edges, by c and d."""

    dE_dc: float
    d2E_dc_dd: float
    d2E_dc2: float


@large_kernel
def add_contacts(
    model: Model, candidates: Candidates, points: PointState, stencil: Stencil, system: NewtonSystem, matrix: int
) -> tuple[float, int]:
    """Add all pairs closer than d_hat; return the smallest distance [m] and their number."""
    y, y_start, d_hat, terms = points.y, points.y_start, model.parameters.d_hat_m, stencil.terms
    smallest, active = np.inf, 0
    for k in range(len(candidates.pair_type)):
        if candidates.distance_m[k] - points.motion[candidates.bodies[k]] >= d_hat:
            continue
        corners, pair_type = candidates.points, candidates.pair_type[k]
        p0, p1, p2, p3 = corners[k, 0], corners[k, 1], corners[k, 2], corners[k, 3]
        x = (load(y, p0), load(y, p1), load(y, p2), load(y, p3))
        c, sliding, r = closest_points(pair_type, x[0], x[1], x[2], x[3])
        if dot(r, r) >= d_hat * d_hat:
            continue
        moves = (
            subtract(x[0], load(y_start, p0)),
            subtract(x[1], load(y_start, p1)),
            subtract(x[2], load(y_start, p2)),
            subtract(x[3], load(y_start, p3)),
        )
        counted, factor, slip_m = 1, 1.0, NO_SLIP
        if model.parameters.counts_once:
            counted = write_terms(model.surfaces, candidates.triangle[k], y, x, c, terms)
        for term in range(counted):
            if model.parameters.counts_once:
                c, sliding, r = separation(terms, term, x)
                factor = terms.factor[term]
                if dot(r, r) >= d_hat * d_hat:
                    continue
            if matrix == NO_MATRIX:
                sliding = NO_SLIDING
            geometry = contact_geometry(x, moves, c, sliding, r)
            smallest = min(smallest, geometry.d)
            active += 1
            if pair_type == POINT_TRIANGLE or term == 0:
                slip_m = recall_slip(points.memory, model.surfaces, candidates, k, y, geometry.n)
            w = add(weighted_sum(c, moves), slip_m)
            dual_row = k if term == 0 and factor > 0.0 else _NO_DUAL
            pair = PairProperties(factor, candidates.friction[k], candidates.mollifier_eps_m4[k], dual_row, w)
            modes = _write_modes(model.parameters, pair, geometry, candidates.dual, stencil, matrix)
            split = 2 if pair_type == EDGE_EDGE else 1
            count = collect_nodes(model.points, corners, k, split, modes, stencil)
            add_forces(stencil, count, modes, system.gradient)
            if matrix == EXACT_MATRIX or (matrix == PROJECTED_MATRIX and factor > 0.0):
                add_blocks(stencil, count, PLAIN_MODES if matrix == PROJECTED_MATRIX else modes, model, system)
    return smallest, active


@kernel
def _write_modes(
    parameters: Parameters,
    pair: PairProperties,
    geometry: ContactGeometry,
    dual: FloatArray,
    stencil: Stencil,
    matrix: int,
) -> int:
    """Write weights, forces and, where a matrix is asked for, blocks of a contact's modes; returns their number."""
    kappa, x, weights = pair.factor * parameters.barrier_stiffness_n_m, geometry.x, stencil.point_weights
    b, db_dd, d2b_dd2 = barrier(geometry.d, parameters.d_hat_m)
    e, de_dc, d2e_dc2 = 1.0, 0.0, 0.0
    if pair.mollifier_eps_m4 > 0.0:
        c = squared_cross_norm(subtract(x[1], x[0]), subtract(x[3], x[2]))
        e, de_dc, d2e_dc2 = mollifier(c, pair.mollifier_eps_m4)
    normal = NormalForce(-kappa * e * db_dd, kappa * e * d2b_dd2)
    w = pair.slip_m
    u = subtract(w, scale(dot(w, geometry.n), geometry.n))
    mu, stiffness_n_m = pair.friction_coefficient, parameters.tangential_stiffness_n_m
    law = drag(np.sqrt(dot(u, u)), normal.force_n, mu, parameters.slip_scale_m, stiffness_n_m)
    dual_m, coulomb_n = u, mu * normal.force_n
    if matrix == EXACT_MATRIX and parameters.remembers_slip and pair.dual_row != _NO_DUAL and coulomb_n > 0.0:
        dual_m = update_dual(dual, pair.dual_row, u, coulomb_n / stiffness_n_m)
    contact = contact_terms(geometry, normal, Friction(law, w, u, dual_m), matrix)
    set_point_weights(weights, C, geometry.c)
    set_point_weights(weights, FIRST, geometry.first.dc)
    set_point_weights(weights, SECOND, geometry.second.dc)
    set_mode_force(stencil.force, C, contact.f)
    if matrix != NO_MATRIX:
        _write_plain_blocks(contact, geometry, stencil.jacobian)
    if e == 1.0:
        return PLAIN_MODES
    rates = MollifierRates(kappa * b * de_dc, kappa * db_dd * de_dc, kappa * b * d2e_dc2)
    _write_mollifier(contact, geometry, rates, stencil, matrix)
    return ALL_MODES


@kernel
def _write_plain_blocks(contact: Contact, geometry: ContactGeometry, jacobian: FloatArray) -> None:
    """Write df_dr and (c df_ds_k + dc_k df_dc) v_k^T of `contact`, sorted by the modes they act between.

    v_k acts on the mode C as T_k / d and on the k-th sliding direction as n.
    """
    n, df_ds0, df_ds1, df_dc = geometry.n, contact.df_ds[0], contact.df_ds[1], contact.df_dc
    ds0_dr, ds1_dr = scale(1.0 / geometry.d, geometry.first.tangent), scale(1.0 / geometry.d, geometry.second.tangent)
    sliding = add_matrices(outer(df_ds0, ds0_dr), outer(df_ds1, ds1_dr))
    zero = scale_matrix(0.0, sliding)
    set_mode_block(jacobian, C, C, add_matrices(contact.df_dr, sliding))
    set_mode_block(jacobian, C, FIRST, outer(df_ds0, n))
    set_mode_block(jacobian, C, SECOND, outer(df_ds1, n))
    set_mode_block(jacobian, FIRST, C, outer(df_dc, ds0_dr))
    set_mode_block(jacobian, FIRST, FIRST, outer(df_dc, n))
    set_mode_block(jacobian, FIRST, SECOND, zero)
    set_mode_block(jacobian, SECOND, C, outer(df_dc, ds1_dr))
    set_mode_block(jacobian, SECOND, FIRST, zero)
    set_mode_block(jacobian, SECOND, SECOND, outer(df_dc, n))


@kernel
def _write_mollifier(
    contact: Contact, geometry: ContactGeometry, rates: MollifierRates, stencil: Stencil, matrix: int
) -> None:
    """Write the derivatives of the mollifier e(c) in the energy B e(c), on the edge vectors u and v.

    Forces: dE/dc grad c. Blocks: the barrier's and friction's change with c, df/dc (grad c)^T; d2E/dc dd grad c n^T;
    and d2E/dc2 grad c grad c^T + dE/dc hessian c. The blocks between them and sliding directions are never written and
    stay zero.
    """
    n, x, dE_dc, d2E_dc2 = geometry.n, geometry.x, rates.dE_dc, rates.d2E_dc2
    u, v = subtract(x[1], x[0]), subtract(x[3], x[2])
    dc_du, dc_dv = squared_cross_norm_gradient(u, v)
    set_point_weights(stencil.point_weights, U, (-1.0, 1.0, 0.0, 0.0))
    set_point_weights(stencil.point_weights, V, (0.0, 0.0, -1.0, 1.0))
    set_mode_force(stencil.force, U, scale(dE_dc, dc_du))
    set_mode_force(stencil.force, V, scale(dE_dc, dc_dv))
    if matrix == NO_MATRIX:
        return
    uu, uv, vv = squared_cross_norm_blocks(u, v)
    df_dc, jacobian = scale(rates.d2E_dc_dd, subtract(n, contact.dphi_dN)), stencil.jacobian
    set_mode_block(jacobian, C, U, outer(df_dc, dc_du))
    set_mode_block(jacobian, C, V, outer(df_dc, dc_dv))
    set_mode_block(jacobian, U, C, scale_matrix(rates.d2E_dc_dd, outer(dc_du, n)))
    set_mode_block(jacobian, V, C, scale_matrix(rates.d2E_dc_dd, outer(dc_dv, n)))
    set_mode_block(jacobian, U, U, add_matrices(scale_matrix(d2E_dc2, outer(dc_du, dc_du)), scale_matrix(dE_dc, uu)))
    set_mode_block(jacobian, U, V, add_matrices(scale_matrix(d2E_dc2, outer(dc_du, dc_dv)), scale_matrix(dE_dc, uv)))
    set_mode_block(
        jacobian, V, U, add_matrices(scale_matrix(d2E_dc2, outer(dc_dv, dc_du)), scale_matrix(dE_dc, transpose(uv)))
    )
    set_mode_block(jacobian, V, V, add_matrices(scale_matrix(d2E_dc2, outer(dc_dv, dc_dv)), scale_matrix(dE_dc, vv)))
