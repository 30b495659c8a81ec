"""Force and exact Jacobian of one contact: barrier, mollifier and friction together.

With separation r = sum_i c_i x_i, distance d, direction n and slip w = sum_i c_i (x_i - x_i at the start of the step):

    normal force         N = -(kappa / h^2) e(c) b'(d)
    tangential slip      u = w - (w . n) n
    force on point i     c_i (phi - N n),   phi = mu N a u,   a = f1(|u|) / |u|

Friction is taken at the current state, not lagged, so the solution of the step carries a self-consistent friction force
and Newton's method converges quadratically. The Jacobian needs how c, n, N and u change. With the sliding directions
made orthonormal in G (see `distance`), T_k the tangents, s_k = v_k . dx with v_k = dc_k (x) n + c (x) T_k / d, and
C dx = sum_i c_i dx_i:

    dc_i = -d sum_k dc_ki s_k                     dn = (I - n n^T) C dx / d - sum_k T_k s_k
    dN   = -(kappa / h^2) e b'' n . C dx          dw = C dx - d sum_k s_k w_k,   w_k = sum_i dc_ki (x_i - x_i at start)

so every term is C dx or s_k times something, and the block of points i and j is

    c_i c_j base + sum_k left_ki v_kj^T.
"""

from typing import NamedTuple

import numpy as np

from ...compilation import kernel
from ..algebra.mat3 import Mat3, add_matrices, apply_rows, identity_and_outer, multiply_rows
from ..algebra.vec3 import Vec3, add, combine, dot, scale, subtract
from .distance import Coefficients, Sliding
from .friction import slip_factor

Vec4 = Coefficients
Quad = tuple[Vec3, Vec3, Vec3, Vec3]
# Directions whose tangents are this close to parallel count as one (squared sine).
_PARALLEL = 1e-10


class SlidingDirection(NamedTuple):
    """One sliding direction, orthonormal to the other; all zero where there is none."""

    dc: Vec4  # change of the coefficients
    tangent: Vec3  # unit vector along which the closest point moves
    slip: Vec3  # w_k = sum_i dc_i (x_i - x_i at start)


class Contact(NamedTuple):
    """What the forces and Jacobian blocks of a contact are made of."""

    force: Vec3  # phi - N n
    base: Mat3  # rows
    left_c: tuple[Vec3, Vec3]  # left_ki = c_i left_c[k] + dc_ki left_dc
    left_dc: Vec3
    phi_per_newton: Vec3  # phi / N


@kernel
def sliding_directions(sliding: Sliding, x: Quad, moves: Quad) -> tuple[SlidingDirection, SlidingDirection]:
    """Sliding directions of a pair, made orthonormal (Gram-Schmidt); moves are the displacements in the step."""
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
    """sum_i c_i x_i."""
    return add(
        add(scale(c[0], x[0]), scale(c[1], x[1])),
        add(scale(c[2], x[2]), scale(c[3], x[3])),
    )


@kernel
def contact_terms(
    d: float,
    n: Vec3,
    w: Vec3,
    force_n: float,
    stiffness_n_m: float,
    friction: float,
    slip_scale_m: float,
    first: SlidingDirection,
    second: SlidingDirection,
    projected: bool,
) -> Contact:
    """Force and Jacobian factors of a contact.

    Args:
        d: distance [m].
        n: unit direction.
        w: slip including its normal part [m].
        force_n: normal force without the mollifier's e, -(kappa / h^2) b' [N]; the caller passes it times e.
        stiffness_n_m: (kappa / h^2) e b'' [N/m].
        friction: friction coefficient mu.
        slip_scale_m: slip at which friction is fully developed [m].
        first: sliding direction.
        second: sliding direction.
        projected: give the positive semi-definite replacement: no tangential barrier term, friction held.
    """
    w_n = dot(w, n)
    u = subtract(w, scale(w_n, n))
    a, slope = slip_factor(np.sqrt(dot(u, u)), slip_scale_m)
    coulomb = friction * force_n
    phi = scale(coulomb * a, u)
    force = subtract(phi, scale(force_n, n))
    Q = identity_and_outer(coulomb * a, coulomb * slope, u)
    slide = scale(force_n * d, n)
    zero = (0.0, 0.0, 0.0)
    if projected:
        P = identity_and_outer(1.0, -1.0, n)
        base = add_matrices(identity_and_outer(0.0, stiffness_n_m, n), multiply_rows(P, multiply_rows(Q, P)))
        left_c = (scale(force_n, first.tangent), scale(force_n, second.tangent))
        return Contact(force, base, left_c, slide, zero)
    barrier = identity_and_outer(-force_n / d, stiffness_n_m + force_n / d, n)
    du = identity_and_outer(1.0 - w_n / d, w_n / d - 1.0, n)
    lean = scale(1.0 / d, u)
    du = (
        subtract(du[0], scale(n[0], lean)),
        subtract(du[1], scale(n[1], lean)),
        subtract(du[2], scale(n[2], lean)),
    )
    grip = scale(-friction * a * stiffness_n_m, u)
    base = add_matrices(
        add_matrices(barrier, multiply_rows(Q, du)),
        (scale(grip[0], n), scale(grip[1], n), scale(grip[2], n)),
    )
    left_c = (
        add(scale(force_n, first.tangent), _friction_by_sliding(Q, first, n, w, w_n, d)),
        add(
            scale(force_n, second.tangent),
            _friction_by_sliding(Q, second, n, w, w_n, d),
        ),
    )
    return Contact(force, base, left_c, subtract(slide, scale(d, phi)), scale(friction * a, u))


@kernel
def _friction_by_sliding(Q: Mat3, k: SlidingDirection, n: Vec3, w: Vec3, w_n: float, d: float) -> Vec3:
    """D phi / d s_k at held C dx: Q (-d P w_k + (w . n) T_k + (w . T_k) n)."""
    across = subtract(k.slip, scale(dot(k.slip, n), n))
    return apply_rows(Q, combine(-d, across, w_n, k.tangent, dot(k.tangent, w), n))
