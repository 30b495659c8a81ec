"""Force and exact Jacobian of one contact: barrier, mollifier and friction together.

With separation r = sum_i c_i x_i, distance d, direction n and slip w = sum_i c_i (x_i - x_i at the start of the step):

    normal force         N = -(kappa / h^2) e(c) b'(d)
    tangential slip      u = w - (w . n) n,  where w also counts what the contact remembers (see `memory`)
    friction             phi = A u,   A = mu N f1(|u|) / |u|
    force on point i     c_i f,   f = phi - N n

Friction is taken at the current state, not lagged, so the solution of the step carries a self-consistent friction force
and Newton's method converges quadratically. The Jacobian needs how c, n, N and u change. With the sliding directions
made orthonormal in G (see `distance`), T_k the tangents, dr = sum_i c_i dx_i the change of r at held coefficients, and
ds_k = v_k . dx with v_k = dc_k (x) n + c (x) T_k / d the slide along the k-th direction:

    dc_i = -d sum_k dc_ki ds_k                    dn = (I - n n^T) dr / d - sum_k T_k ds_k
    dN   = -(kappa / h^2) e b'' n . dr            dw = dr - d sum_k w_k ds_k,   w_k = sum_i dc_ki (x_i - x_i at start)

so every term is dr or ds_k times something, and the block of points i and j is

    c_i c_j df_dr + sum_k (c_i df_ds_k + dc_ki df_dc) v_kj^T,    df_dc = -d f,

where df_ds_k holds how f itself changes with a slide.
"""

from typing import NamedTuple

import numpy as np

from ...compilation import kernel
from ..algebra import (
    Mat3,
    Vec3,
    add,
    add_matrices,
    apply_rows,
    combine,
    dot,
    identity_and_outer,
    identity_and_outers,
    multiply_rows,
    scale,
    subtract,
)
from ..model.model import NO_MATRIX, PROJECTED_MATRIX
from .barrier import Drag
from .distance import Coefficients, Sliding

Vec4 = Coefficients
Quad = tuple[Vec3, Vec3, Vec3, Vec3]
# Directions whose tangents are this close to parallel count as one (squared sine).
_PARALLEL = 1e-10


class SlidingDirection(NamedTuple):
    """One sliding direction, orthonormal to the other; all zero where there is none."""

    dc: Vec4  # change of the coefficients
    tangent: Vec3  # unit vector along which the closest point moves
    slip: Vec3  # w_k = sum_i dc_i (x_i - x_i at start)


class ContactGeometry(NamedTuple):
    """Where the closest points of a pair are, and how they can move."""

    x: Quad  # [m]
    moves: Quad  # displacements of the points in the step [m]
    c: Coefficients
    d: float  # distance [m]
    n: Vec3  # unit vector of the separation
    first: SlidingDirection
    second: SlidingDirection


class NormalForce(NamedTuple):
    """The barrier's force and its change with the distance, mollifier included."""

    force_n: float  # N
    stiffness_n_m: float  # -dN/dd


class Friction(NamedTuple):
    """Coulomb's law, smoothed."""

    drag: Drag
    whole_slip_m: Vec3  # w
    slip_m: Vec3  # u, its tangential part
    dual_m: Vec3  # what stands for one u in the Jacobian's u u^T: u, or from the dual variable of `friction`


class Contact(NamedTuple):
    """What the forces and Jacobian blocks of a contact are made of."""

    f: Vec3  # phi - N n [N]
    df_dr: Mat3  # rows
    df_ds: tuple[Vec3, Vec3]  # of the two sliding directions
    df_dc: Vec3  # -d f
    dphi_dN: Vec3


@kernel
def contact_geometry(x: Quad, moves: Quad, c: Coefficients, sliding: Sliding, r: Vec3) -> ContactGeometry:
    """Return the geometry of a pair from its closest points: coefficients, sliding directions and separation r [m]."""
    d = np.sqrt(dot(r, r))
    first, second = sliding_directions(sliding, x, moves)
    return ContactGeometry(x, moves, c, d, scale(1.0 / d, r), first, second)


@kernel
def sliding_directions(sliding: Sliding, x: Quad, moves: Quad) -> tuple[SlidingDirection, SlidingDirection]:
    """Return the sliding directions of a pair, orthonormal (Gram-Schmidt); moves are the displacements in the step."""
    first = _direction(sliding[0], sliding[1], x, moves)
    second = _direction(sliding[2], sliding[3], x, moves)
    size = np.sqrt(dot(first.tangent, first.tangent))
    if size > 0.0:
        first = _times(1.0 / size, first)
    along = dot(first.tangent, second.tangent)
    whole = dot(second.tangent, second.tangent)
    left = whole - along * along
    if left <= _PARALLEL * whole:
        return first, _times(0.0, second)
    second = SlidingDirection(
        (
            second.dc[0] - along * first.dc[0],
            second.dc[1] - along * first.dc[1],
            second.dc[2] - along * first.dc[2],
            second.dc[3] - along * first.dc[3],
        ),
        subtract(second.tangent, scale(along, first.tangent)),
        subtract(second.slip, scale(along, first.slip)),
    )
    return first, _times(1.0 / np.sqrt(left), second)


@kernel
def _direction(i: int, j: int, x: Quad, moves: Quad) -> SlidingDirection:
    dc = (
        (1.0 if i == 0 else 0.0) - (1.0 if j == 0 else 0.0),
        (1.0 if i == 1 else 0.0) - (1.0 if j == 1 else 0.0),
        (1.0 if i == 2 else 0.0) - (1.0 if j == 2 else 0.0),
        (1.0 if i == 3 else 0.0) - (1.0 if j == 3 else 0.0),
    )
    return SlidingDirection(dc, weighted_sum(dc, x), weighted_sum(dc, moves))


@kernel
def _times(s: float, k: SlidingDirection) -> SlidingDirection:
    dc = (s * k.dc[0], s * k.dc[1], s * k.dc[2], s * k.dc[3])
    return SlidingDirection(dc, scale(s, k.tangent), scale(s, k.slip))


@kernel
def weighted_sum(c: Vec4, x: Quad) -> Vec3:
    """Return sum_i c_i x_i."""
    return add(
        add(scale(c[0], x[0]), scale(c[1], x[1])),
        add(scale(c[2], x[2]), scale(c[3], x[3])),
    )


@kernel
def contact_terms(geometry: ContactGeometry, normal: NormalForce, friction: Friction, matrix: int) -> Contact:
    """Return the force and, where a matrix is asked for, the Jacobian factors of a contact.

    Those of the positive semi-definite replacement have no tangential barrier term, and friction is held.
    """
    d, n, force_n = geometry.d, geometry.n, normal.force_n
    w, u = friction.whole_slip_m, friction.slip_m
    w_n = dot(w, n)
    phi = scale(friction.drag.a_n_m, u)
    f = subtract(phi, scale(force_n, n))
    if matrix == NO_MATRIX:
        zero = (0.0, 0.0, 0.0)
        return Contact(f, (zero, zero, zero), (zero, zero), zero, zero)
    dphi_du = identity_and_outers(friction.drag.a_n_m, friction.drag.slope_n_m3, friction.dual_m, u, 0.0)
    T0, T1 = geometry.first.tangent, geometry.second.tangent
    if matrix == PROJECTED_MATRIX:
        P = identity_and_outer(1.0, -1.0, n)
        barrier = identity_and_outer(0.0, normal.stiffness_n_m, n)
        df_dr = add_matrices(barrier, multiply_rows(P, multiply_rows(dphi_du, P)))
        df_ds = (scale(force_n, T0), scale(force_n, T1))
        return Contact(f, df_dr, df_ds, scale(force_n * d, n), (0.0, 0.0, 0.0))
    dphi_dN = scale(friction.drag.by_normal_force_1_m, u)
    dphi_dd = scale(-friction.drag.by_normal_force_1_m * normal.stiffness_n_m, u)
    du_dr = _slip_by_separation(u, n, w_n, d)
    # -d(N n)/dr
    barrier = identity_and_outer(-force_n / d, normal.stiffness_n_m + force_n / d, n)
    df_dr = add_matrices(
        add_matrices(barrier, multiply_rows(dphi_du, du_dr)),
        (scale(dphi_dd[0], n), scale(dphi_dd[1], n), scale(dphi_dd[2], n)),
    )
    df_ds = (
        add(scale(force_n, T0), apply_rows(dphi_du, _slip_by_slide(geometry.first, geometry, w, w_n))),
        add(scale(force_n, T1), apply_rows(dphi_du, _slip_by_slide(geometry.second, geometry, w, w_n))),
    )
    return Contact(f, df_dr, df_ds, subtract(scale(force_n * d, n), scale(d, phi)), dphi_dN)


@kernel
def _slip_by_separation(u: Vec3, n: Vec3, w_n: float, d: float) -> Mat3:
    """Return the rows of du/dr = (1 - (w . n) / d) (I - n n^T) - n u^T / d."""
    du_dr = identity_and_outer(1.0 - w_n / d, w_n / d - 1.0, n)
    u_d = scale(1.0 / d, u)
    return (
        subtract(du_dr[0], scale(n[0], u_d)),
        subtract(du_dr[1], scale(n[1], u_d)),
        subtract(du_dr[2], scale(n[2], u_d)),
    )


@kernel
def _slip_by_slide(k: SlidingDirection, geometry: ContactGeometry, w: Vec3, w_n: float) -> Vec3:
    """Return du/ds_k = -d (I - n n^T) w_k + (w . n) T_k + (w . T_k) n, at held r."""
    n = geometry.n
    across = subtract(k.slip, scale(dot(k.slip, n), n))
    return combine(-geometry.d, across, w_n, k.tangent, dot(k.tangent, w), n)
