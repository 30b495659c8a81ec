"""Forces and Newton system of one IPC step, summed over all terms.

The step minimises, at friction forces consistent with its solution,

    E(x) = sum_nodes m |x - x_hat|^2 / (2 h^2) + sum_tets V psi(F) + sum_bodies (affine inertia + orthogonality)
         + sum_pairs (kappa / h^2) e(c) b(d) + sum_contacts mu N f0(|u|)                          [J]

which is the incremental potential of Li et al., Incremental Potential Contact (ACM TOG 2020), equation 5, over h^2.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from ..deterministic_math import natural_log
from .affine_body import (
    affine_columns,
    orthogonality_block,
    orthogonality_error,
    orthogonality_gradient,
)
from .barrier import barrier
from .broad_phase import Candidates
from .contact import (
    ContactTerms,
    Quad,
    Vec4,
    contact_terms,
    sliding_directions,
    weighted_sum,
)
from .distance import EDGE_EDGE, Sliding, closest_points
from .linear_solve import BlockLayout, SystemLayout, add_block, block_place
from .model import PRESCRIBED, Affine, Elastic, Model, Parameters, Points
from .mollifier import (
    mollifier,
    squared_cross_norm,
    squared_cross_norm_blocks,
    squared_cross_norm_gradient,
)
from .neo_hookean import (
    Mat3,
    apply,
    cofactors,
    deformation_gradient,
    nodal_gradient,
    projected_stiffness_block,
    stiffness_block,
)
from .vec3 import Vec3, add, combine, dot, load, scale, subtract

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
Indices = tuple[int, int, int, int]

# Columns of the stencil table: what a node of a contact contributes to its Jacobian block.
_C, _DC, _LEFT, _V, _STENCIL_COLUMNS = 0, 1, 3, 9, 15


class Target(NamedTuple):
    """Where contact blocks go."""

    entries: FloatArray
    coupling: FloatArray
    prescribed_move: FloatArray
    slot: IndexArray


class Workspace(NamedTuple):
    """Arrays that `assemble` fills."""

    entries: FloatArray  # the system, see `linear_solve`
    gradient: FloatArray  # [n, 3] dE/dx [N], prescribed nodes included
    coupling: FloatArray  # [n, 3] Jacobian times the prescribed motion [N]
    smallest: FloatArray  # [2] smallest gap [m], smallest det F
    active: IndexArray  # [1] pairs closer than d_hat
    stencil_nodes: IndexArray  # [8] nodes of one contact
    stencil: FloatArray  # [8, _STENCIL_COLUMNS]


def new_workspace(layout: SystemLayout, nodes: int) -> Workspace:
    """Uninitialised arrays for a system of this layout and so many nodes."""
    return Workspace(
        entries=np.empty(layout.size),
        gradient=np.empty((nodes, 3)),
        coupling=np.empty((nodes, 3)),
        smallest=np.empty(2),
        active=np.empty(1, dtype=np.int64),
        stencil_nodes=np.empty(8, dtype=np.int64),
        stencil=np.zeros((8, _STENCIL_COLUMNS)),
    )


@kernel
def point_positions(points: Points, x: FloatArray, y: FloatArray) -> None:
    """Write positions (or displacements) of all surface points, y [p, 3], from those of the nodes, x [n, 3]."""
    nodes, weights, count = points.nodes, points.weights, points.node_count
    for p in range(len(count)):
        if count[p] == 1:
            for k in range(3):
                y[p, k] = x[nodes[p, 0], k]
        else:
            for k in range(3):
                y[p, k] = (
                    weights[p, 0] * x[nodes[p, 0], k]
                    + weights[p, 1] * x[nodes[p, 1], k]
                    + weights[p, 2] * x[nodes[p, 2], k]
                    + weights[p, 3] * x[nodes[p, 3], k]
                )


@kernel
def assemble(
    model: Model,
    candidates: Candidates,
    x: FloatArray,
    x_hat: FloatArray,
    y: FloatArray,
    y_start: FloatArray,
    prescribed_move: FloatArray,
    workspace: Workspace,
    projected: bool,
) -> None:
    """Write forces and system at nodes x [m] with points y; `projected` asks for a positive semi-definite matrix.

    The right-hand side also carries the prescribed nodes' motion [m], of shape [n, 3], moved to the known side.
    """
    workspace.entries[:] = 0.0
    workspace.gradient[:] = 0.0
    workspace.coupling[:] = 0.0
    workspace.smallest[1] = _add_elasticity(
        model.elastic,
        x,
        prescribed_move,
        workspace.entries,
        workspace.gradient,
        workspace.coupling,
        projected,
    )
    _add_inertia(model, x, x_hat, workspace.entries, workspace.gradient)
    _add_orthogonality(
        model.affine,
        model.system.block,
        x,
        workspace.entries,
        workspace.gradient,
        projected,
    )
    _add_contacts(model, candidates, y, y_start, prescribed_move, workspace, projected)
    _write_right_hand_side(model, workspace)


@kernel
def _write_right_hand_side(model: Model, workspace: Workspace) -> None:
    layout = model.system.block
    n, m = layout.n, layout.m
    entries, gradient, coupling = (
        workspace.entries,
        workspace.gradient,
        workspace.coupling,
    )
    for u in range(len(model.unknowns.node)):
        node, row = model.unknowns.node[u], 3 * u
        for k in range(3):
            value = -gradient[node, k] - coupling[node, k]
            if row < n:
                entries[layout.right + (row + k) * (m + 1) + m] = value
            else:
                entries[layout.corner + (row + k - n) * (m + 1) + m] = value


@kernel
def _add_vector(rows: FloatArray, i: int, v: Vec3) -> None:
    rows[i, 0] += v[0]
    rows[i, 1] += v[1]
    rows[i, 2] += v[2]


@kernel
def _add_elasticity(
    elastic: Elastic,
    x: FloatArray,
    prescribed_move: FloatArray,
    entries: FloatArray,
    gradient: FloatArray,
    coupling: FloatArray,
    projected: bool,
) -> float:
    """Add all tetrahedra; returns the smallest det F."""
    nodes, places, strides = elastic.nodes, elastic.places, elastic.stride
    smallest = np.inf
    for t in range(len(elastic.volume_m3)):
        n = (nodes[t, 0], nodes[t, 1], nodes[t, 2], nodes[t, 3])
        g1, g2, g3 = (
            _rest_gradient(elastic, t, 1),
            _rest_gradient(elastic, t, 2),
            _rest_gradient(elastic, t, 3),
        )
        g = (scale(-1.0, add(add(g1, g2), g3)), g1, g2, g3)
        F = deformation_gradient(load(x, n[0]), load(x, n[1]), load(x, n[2]), load(x, n[3]), g1, g2, g3)
        cofactor, J = cofactors(F)
        smallest = min(smallest, J)
        volume, mu, lam = elastic.volume_m3[t], elastic.mu_pa[t], elastic.lambda_pa[t]
        pressure = lam * natural_log(J) - mu
        inverse = 1.0 / J
        inverse_transpose = (
            scale(inverse, cofactor[0]),
            scale(inverse, cofactor[1]),
            scale(inverse, cofactor[2]),
        )
        inverse_b = _outer_square(inverse_transpose)
        h = (
            apply(inverse_transpose, g[0]),
            apply(inverse_transpose, g[1]),
            apply(inverse_transpose, g[2]),
            apply(inverse_transpose, g[3]),
        )
        for a in range(4):
            ga, ha = g[a], h[a]
            _add_vector(gradient, n[a], nodal_gradient(volume, mu, pressure, apply(F, ga), ha))
            for b in range(a, 4):
                place, mirrored = places[t, 4 * a + b], places[t, 4 * b + a]
                if place < 0 and mirrored < 0 and not elastic.reaction[t, 4 * a + b]:
                    continue
                gg, hb = dot(ga, g[b]), h[b]
                if projected:
                    block = projected_stiffness_block(volume, mu, lam, pressure, gg, ha, hb, inverse_b)
                else:
                    block = stiffness_block(volume, mu, lam, pressure, gg, ha, hb)
                if place >= 0:
                    add_block(entries, place, strides, block)
                    if b > a:
                        add_block(entries, mirrored, strides, _transposed(block))
                else:
                    _add_vector(coupling, n[a], _times_rows(block, load(prescribed_move, n[b])))
                    _add_vector(
                        coupling,
                        n[b],
                        _times_columns(block, load(prescribed_move, n[a])),
                    )
    return smallest


@kernel
def _rest_gradient(elastic: Elastic, t: int, a: int) -> Vec3:
    gradients = elastic.gradients_1_m
    return gradients[t, a, 0], gradients[t, a, 1], gradients[t, a, 2]


@kernel
def _transposed(rows: Mat3) -> Mat3:
    a, b, c = rows
    return (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])


@kernel
def _times_rows(rows: Mat3, v: Vec3) -> Vec3:
    return dot(rows[0], v), dot(rows[1], v), dot(rows[2], v)


@kernel
def _times_columns(rows: Mat3, v: Vec3) -> Vec3:
    return add(add(scale(v[0], rows[0]), scale(v[1], rows[1])), scale(v[2], rows[2]))


@kernel
def _outer_square(columns: Mat3) -> Mat3:
    """Rows of M M^T for a matrix given by its columns."""
    a, b, c = columns
    return (
        add(add(scale(a[0], a), scale(b[0], b)), scale(c[0], c)),
        add(add(scale(a[1], a), scale(b[1], b)), scale(c[1], c)),
        add(add(scale(a[2], a), scale(b[2], b)), scale(c[2], c)),
    )


@kernel
def _add_inertia(
    model: Model,
    x: FloatArray,
    x_hat: FloatArray,
    entries: FloatArray,
    gradient: FloatArray,
) -> None:
    inverse_h2 = 1.0 / (model.parameters.time_step_s * model.parameters.time_step_s)
    unknown_nodes, masses = model.unknowns.node, model.unknowns.node_mass_kg
    for u in range(model.system.block.n // 3):
        node = unknown_nodes[u]
        m = masses[node] * inverse_h2
        _add_vector(gradient, node, scale(m, subtract(load(x, node), load(x_hat, node))))
        place, stride = block_place(model.system.block, u, u)
        _add_multiple_of_identity(entries, place, stride, m)
    affine = model.affine
    for i in range(len(affine.first_node)):
        for k in range(4):
            for j in range(4):
                m = affine.mass_kg[i, k, j] * inverse_h2
                node = affine.first_node[i] + j
                offset = subtract(load(x, node), load(x_hat, node))
                _add_vector(gradient, affine.first_node[i] + k, scale(m, offset))
                place, stride = block_place(
                    model.system.block,
                    affine.first_unknown[i] + k,
                    affine.first_unknown[i] + j,
                )
                _add_multiple_of_identity(entries, place, stride, m)


@kernel
def _add_multiple_of_identity(entries: FloatArray, place: int, stride: int, m: float) -> None:
    entries[place] += m
    entries[place + stride + 1] += m
    entries[place + 2 * stride + 2] += m


@kernel
def _add_orthogonality(
    affine: Affine,
    system: BlockLayout,
    x: FloatArray,
    entries: FloatArray,
    gradient: FloatArray,
    projected: bool,
) -> None:
    for i in range(len(affine.first_node)):
        node, unknown = affine.first_node[i], affine.first_unknown[i]
        length, stiffness = affine.frame_length_m[i], affine.stiffness_j[i]
        A = affine_columns(x, node, length)
        E = orthogonality_error(A)
        for k in range(3):
            force = scale(stiffness / length, orthogonality_gradient(E, A[k]))
            _add_vector(gradient, node + 1 + k, force)
            _add_vector(gradient, node, scale(-1.0, force))
            for j in range(3):
                block = _scaled(
                    stiffness / (length * length),
                    orthogonality_block(E, A[k], A[j], k == j, projected),
                )
                opposite = _scaled(-1.0, block)
                # The block acts between the differences y_k - y_0 and y_l - y_0.
                _add_unknown_block(system, entries, unknown + 1 + k, unknown + 1 + j, block)
                _add_unknown_block(system, entries, unknown, unknown, block)
                _add_unknown_block(system, entries, unknown + 1 + k, unknown, opposite)
                _add_unknown_block(system, entries, unknown, unknown + 1 + j, opposite)


@kernel
def _scaled(s: float, block: Mat3) -> Mat3:
    return scale(s, block[0]), scale(s, block[1]), scale(s, block[2])


@kernel
def _add_unknown_block(system: BlockLayout, entries: FloatArray, a: int, b: int, block: Mat3) -> None:
    place, stride = block_place(system, a, b)
    add_block(entries, place, stride, block)


@kernel
def _add_contacts(
    model: Model,
    candidates: Candidates,
    y: FloatArray,
    y_start: FloatArray,
    prescribed_move: FloatArray,
    workspace: Workspace,
    projected: bool,
) -> None:
    kinds, points = candidates.kind, candidates.points
    d_hat = model.parameters.d_hat_m
    target = Target(workspace.entries, workspace.coupling, prescribed_move, model.unknowns.slot)
    smallest = np.inf
    active = 0
    for k in range(len(kinds)):
        p = (points[k, 0], points[k, 1], points[k, 2], points[k, 3])
        x = (load(y, p[0]), load(y, p[1]), load(y, p[2]), load(y, p[3]))
        c, sliding, r = closest_points(kinds[k], x[0], x[1], x[2], x[3])
        squared = dot(r, r)
        if squared < d_hat * d_hat:
            d = np.sqrt(squared)
            smallest = min(smallest, d)
            active += 1
            start = (
                load(y_start, p[0]),
                load(y_start, p[1]),
                load(y_start, p[2]),
                load(y_start, p[3]),
            )
            _add_contact(
                model.parameters,
                model.points,
                model.system.block,
                kinds[k],
                candidates.friction[k],
                candidates.mollifier_eps_m4[k],
                p,
                x,
                start,
                c,
                sliding,
                d,
                scale(1.0 / d, r),
                target,
                workspace.gradient,
                workspace.stencil_nodes,
                workspace.stencil,
                projected,
            )
    workspace.smallest[0] = smallest
    workspace.active[0] = active


@kernel
def _add_contact(
    parameters: Parameters,
    points: Points,
    system: BlockLayout,
    kind: int,
    friction: float,
    mollifier_eps: float,
    p: Indices,
    x: Quad,
    start: Quad,
    c: Vec4,
    sliding: Sliding,
    d: float,
    n: Vec3,
    target: Target,
    gradient: FloatArray,
    nodes: IndexArray,
    table: FloatArray,
    projected: bool,
) -> None:
    kappa = parameters.barrier_stiffness_n_m
    b, b_first, b_second = barrier(d, parameters.d_hat_m)
    e, e_first, e_second = 1.0, 0.0, 0.0
    u, v = subtract(x[1], x[0]), subtract(x[3], x[2])
    if kind == EDGE_EDGE:
        e, e_first, e_second = mollifier(squared_cross_norm(u, v), mollifier_eps)
    moves = (
        subtract(x[0], start[0]),
        subtract(x[1], start[1]),
        subtract(x[2], start[2]),
        subtract(x[3], start[3]),
    )
    first, second = sliding_directions(sliding, x, moves)
    terms = contact_terms(
        d,
        n,
        weighted_sum(c, moves),
        -kappa * e * b_first,
        kappa * e * b_second,
        friction,
        parameters.slip_scale_m,
        first,
        second,
        projected,
    )
    count = _fill_stencil(points, kind, p, c, first.dc, second.dc, nodes, table)
    _fill_factors(table, count, terms, first.tangent, second.tangent, n, 1.0 / d)
    for i in range(count):
        _add_vector(gradient, nodes[i], scale(table[i, _C], terms.force))
    _add_contact_blocks(count, terms.base, table, nodes, target, system)
    if e < 1.0:
        rate = add(
            scale(kappa * b_first * e_first, n),
            scale(-kappa * b_first * e_first, terms.phi_per_newton),
        )
        _add_mollifier(
            points,
            system,
            kind,
            p,
            c,
            u,
            v,
            n,
            kappa * b_first * e_first,
            rate,
            kappa * b * e_first,
            kappa * b * e_second,
            target,
            gradient,
            nodes,
            table,
            projected,
        )


@kernel
def _fill_stencil(
    points: Points,
    kind: int,
    p: Indices,
    c: Vec4,
    dc0: Vec4,
    dc1: Vec4,
    nodes: IndexArray,
    table: FloatArray,
) -> int:
    """Collapse a contact's points onto their nodes, writing columns _C and _DC; returns the number of nodes.

    A gel node that no coefficient touches (the far corner of a triangle that is touched at an edge) is left out.
    """
    split = 2 if kind == EDGE_EDGE else 1
    count = _fill_side(
        points.node_count,
        points.nodes,
        points.weights,
        p,
        c,
        dc0,
        dc1,
        0,
        split,
        nodes,
        table,
        0,
    )
    return _fill_side(
        points.node_count,
        points.nodes,
        points.weights,
        p,
        c,
        dc0,
        dc1,
        split,
        4,
        nodes,
        table,
        count,
    )


@kernel
def _fill_side(
    counts: IndexArray,
    point_nodes: IndexArray,
    weights: FloatArray,
    p: Indices,
    c: Vec4,
    dc0: Vec4,
    dc1: Vec4,
    low: int,
    high: int,
    nodes: IndexArray,
    table: FloatArray,
    count: int,
) -> int:
    if counts[p[low]] == 1:
        for i in range(low, high):
            if c[i] != 0.0 or dc0[i] != 0.0 or dc1[i] != 0.0:
                nodes[count] = point_nodes[p[i], 0]
                table[count, _C], table[count, _DC], table[count, _DC + 1] = (
                    c[i],
                    dc0[i],
                    dc1[i],
                )
                count += 1
        return count
    for k in range(4):
        a, b0, b1 = 0.0, 0.0, 0.0
        for i in range(low, high):
            weight = weights[p[i], k]
            a += c[i] * weight
            b0 += dc0[i] * weight
            b1 += dc1[i] * weight
        nodes[count + k] = point_nodes[p[low], k]
        table[count + k, _C], table[count + k, _DC], table[count + k, _DC + 1] = (
            a,
            b0,
            b1,
        )
    return count + 4


@kernel
def _fill_factors(
    table: FloatArray,
    count: int,
    terms: ContactTerms,
    tangent0: Vec3,
    tangent1: Vec3,
    n: Vec3,
    inverse_d: float,
) -> None:
    """Write the factors left and v of the Jacobian blocks, from columns _C and _DC."""
    for i in range(count):
        ci, dc0, dc1 = table[i, _C], table[i, _DC], table[i, _DC + 1]
        s = ci * inverse_d
        _store(table, i, _LEFT, combine(ci, terms.left_c[0], dc0, terms.left_dc, 0.0, n))
        _store(
            table,
            i,
            _LEFT + 3,
            combine(ci, terms.left_c[1], dc1, terms.left_dc, 0.0, n),
        )
        _store(table, i, _V, combine(dc0, n, s, tangent0, 0.0, n))
        _store(table, i, _V + 3, combine(dc1, n, s, tangent1, 0.0, n))


@kernel
def _store(table: FloatArray, i: int, column: int, v: Vec3) -> None:
    table[i, column] = v[0]
    table[i, column + 1] = v[1]
    table[i, column + 2] = v[2]


@kernel
def _add_contact_blocks(
    count: int,
    base: Mat3,
    table: FloatArray,
    nodes: IndexArray,
    target: Target,
    system: BlockLayout,
) -> None:
    """Add c_i c_j base + sum_k left_ki v_kj^T for all pairs of the stencil's nodes."""
    for i in range(count):
        if target.slot[nodes[i]] == PRESCRIBED:
            continue
        row = _scaled(table[i, _C], base)
        left0 = (table[i, _LEFT], table[i, _LEFT + 1], table[i, _LEFT + 2])
        left1 = (table[i, _LEFT + 3], table[i, _LEFT + 4], table[i, _LEFT + 5])
        for j in range(count):
            cj = table[j, _C]
            v0 = (table[j, _V], table[j, _V + 1], table[j, _V + 2])
            v1 = (table[j, _V + 3], table[j, _V + 4], table[j, _V + 5])
            block = (
                combine(cj, row[0], left0[0], v0, left1[0], v1),
                combine(cj, row[1], left0[1], v0, left1[1], v1),
                combine(cj, row[2], left0[2], v0, left1[2], v1),
            )
            _add_node_block(nodes[i], nodes[j], block, target, system)


@kernel
def _add_node_block(node_a: int, node_b: int, block: Mat3, target: Target, system: BlockLayout) -> None:
    """Add the derivative of the force on one node by the position of another."""
    a, b = target.slot[node_a], target.slot[node_b]
    if a == PRESCRIBED:
        return
    if b == PRESCRIBED:
        _add_vector(
            target.coupling,
            node_a,
            _times_rows(block, load(target.prescribed_move, node_b)),
        )
    elif max(a, b) < system.n // 3 and abs(a - b) > system.band_width:
        _add_bound(system, target.entries, a, b, block)
    else:
        place, stride = block_place(system, a, b)
        add_block(target.entries, place, stride, block)


@kernel
def _add_bound(system: BlockLayout, entries: FloatArray, a: int, b: int, block: Mat3) -> None:
    """Replace a coupling outside the band (two gels that touch) by a bound on it, which only slows convergence."""
    place_a, stride_a = block_place(system, a, a)
    place_b, stride_b = block_place(system, b, b)
    for i in range(3):
        for j in range(3):
            entries[place_a + i * (stride_a + 1)] += 0.5 * abs(block[i][j])
            entries[place_b + j * (stride_b + 1)] += 0.5 * abs(block[i][j])


@kernel
def _add_mollifier(
    points: Points,
    system: BlockLayout,
    kind: int,
    p: Indices,
    c: Vec4,
    u: Vec3,
    v: Vec3,
    n: Vec3,
    force_rate: float,
    rate: Vec3,
    slope: float,
    curvature: float,
    target: Target,
    gradient: FloatArray,
    nodes: IndexArray,
    table: FloatArray,
    projected: bool,
) -> None:
    """Add the derivatives of the mollifier e(c) in the energy B e(c), B = (kappa / h^2) b.

    Forces: slope grad c, slope = B e'. Blocks: the barrier's and friction's change with c, c_i rate (grad c)_j^T;
    force_rate (grad c)_i c_j n^T with force_rate = dB/dd e'; and curvature grad c grad c^T + slope hessian c with
    curvature = B e''. The projected matrix leaves all these blocks out.
    """
    gu, gv = squared_cross_norm_gradient(u, v)
    count = _fill_stencil(points, kind, p, c, (-1.0, 1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 1.0), nodes, table)
    for i in range(count):
        gi = add(scale(table[i, _DC], gu), scale(table[i, _DC + 1], gv))
        _add_vector(gradient, nodes[i], scale(slope, gi))
    if projected:
        return
    uu, uv, vv = squared_cross_norm_blocks(u, v)
    vu = _transposed(uv)
    for i in range(count):
        ui, vi = table[i, _DC], table[i, _DC + 1]
        gi = add(scale(ui, gu), scale(vi, gv))
        ri = scale(table[i, _C], rate)
        for j in range(count):
            uj, vj = table[j, _DC], table[j, _DC + 1]
            gj = add(scale(uj, gu), scale(vj, gv))
            along = add(scale(force_rate * table[j, _C], n), scale(curvature, gj))
            block = (
                add(scale(ri[0], gj), scale(gi[0], along)),
                add(scale(ri[1], gj), scale(gi[1], along)),
                add(scale(ri[2], gj), scale(gi[2], along)),
            )
            bend = _sum_scaled(ui * uj, uu, ui * vj, uv, vi * uj, vu, vi * vj, vv)
            _add_node_block(nodes[i], nodes[j], _sum(block, _scaled(slope, bend)), target, system)


@kernel
def _sum(a: Mat3, b: Mat3) -> Mat3:
    return add(a[0], b[0]), add(a[1], b[1]), add(a[2], b[2])


@kernel
def _sum_scaled(p: float, a: Mat3, q: float, b: Mat3, r: float, c: Mat3, s: float, d: Mat3) -> Mat3:
    return _sum(_sum(_scaled(p, a), _scaled(q, b)), _sum(_scaled(r, c), _scaled(s, d)))
