"""A second material, written as `elastic.neo_hookean` is: St. Venant and Kirchhoff's.

    psi(F) = mu tr E^2 + lambda/2 (tr E)^2     [J/m^3],  E = (F^T F - I) / 2,  S = 2 mu E + lambda tr E I

Sifakis & Barbic, FEM Simulation of 3D Deformable Solids (2012), section 3.3. With p_a = F dN_a/dX and B = F F^T

    dE/dx_a       = V F S dN_a/dX
    d2E/dx_a dx_b = V ( (dN_a/dX . S dN_b/dX) I + mu (dN_a/dX . dN_b/dX) B + mu p_b p_a^T + lambda p_a p_b^T )
"""

from typing import Any, NamedTuple

import numpy as np
from vitac.envs.compilation import kernel
from vitac.envs.fem.algebra import (
    Mat3,
    add_matrices,
    apply_columns,
    dot,
    identity_and_outers,
    outer_square,
    scale,
    scale_matrix,
)
from vitac.envs.fem.elastic.batch import (
    ROWS,
    Corners,
    cofactors,
    deformation_gradient,
    first_rows,
    get_corners,
    get_number,
    get_vector,
    rest_gradients,
    set_number,
    set_vector,
)

FloatArray = np.ndarray[Any, np.dtype[np.float64]]


class _OwnRows(NamedTuple):
    """First rows in a batch of what the stiffness takes from the strain."""

    deformation: int  # columns of F
    stress: int  # columns of S [Pa]
    end: int


_OWN = _OwnRows(*first_rows([9, 9], ROWS.end))
BATCH_ROWS = _OWN.end


class Strained(NamedTuple):
    """What the stiffness of a strained tetrahedron is made of."""

    volume: float  # [m^3]
    mu: float  # [Pa]
    lam: float  # [Pa]
    dN_dX: Corners  # [1/m]
    F: Mat3  # columns
    S: Mat3  # columns [Pa]


@kernel
def write_forces(batch: FloatArray, i: int) -> None:
    """Write det F and the forces of tetrahedron i of a batch, and what `strained` reads."""
    dN_dX = rest_gradients(batch, i)
    F = deformation_gradient(get_corners(batch, ROWS.position, i), dN_dX)
    _, J = cofactors(F)
    S = _stress(F, get_number(batch, ROWS.mu, i), get_number(batch, ROWS.lam, i))
    set_number(batch, ROWS.det_f, i, J)
    for k in range(3):
        set_vector(batch, _OWN.deformation, k, i, F[k])
        set_vector(batch, _OWN.stress, k, i, S[k])
    for a in range(4):
        force = apply_columns(F, apply_columns(S, dN_dX[a]))
        set_vector(batch, ROWS.force, a, i, scale(get_number(batch, ROWS.volume, i), force))


@kernel
def _stress(F: Mat3, mu: float, lam: float) -> Mat3:
    trace = 0.5 * (dot(F[0], F[0]) + dot(F[1], F[1]) + dot(F[2], F[2]) - 3.0)
    d = lam * trace - mu
    return (
        (mu * dot(F[0], F[0]) + d, mu * dot(F[1], F[0]), mu * dot(F[2], F[0])),
        (mu * dot(F[0], F[1]), mu * dot(F[1], F[1]) + d, mu * dot(F[2], F[1])),
        (mu * dot(F[0], F[2]), mu * dot(F[1], F[2]), mu * dot(F[2], F[2]) + d),
    )


@kernel
def strained(batch: FloatArray, i: int) -> Strained:
    """Return what the stiffness of tetrahedron i of a batch is made of."""
    F, S = _OWN.deformation, _OWN.stress
    return Strained(
        get_number(batch, ROWS.volume, i),
        get_number(batch, ROWS.mu, i),
        get_number(batch, ROWS.lam, i),
        rest_gradients(batch, i),
        (get_vector(batch, F, 0, i), get_vector(batch, F, 1, i), get_vector(batch, F, 2, i)),
        (get_vector(batch, S, 0, i), get_vector(batch, S, 1, i), get_vector(batch, S, 2, i)),
    )


@kernel
def stiffness_block(s: Strained, a: int, b: int) -> Mat3:
    """Rows of d2E/dx_a dx_b [N/m]."""
    along = s.volume * dot(s.dN_dX[a], apply_columns(s.S, s.dN_dX[b]))
    return add_matrices(
        identity_and_outers(along, 0.0, s.dN_dX[a], s.dN_dX[b], 0.0), projected_stiffness_block(s, a, b)
    )


@kernel
def projected_stiffness_block(s: Strained, a: int, b: int) -> Mat3:
    """Rows of a positive semi-definite replacement: without the only indefinite term, that of the stress."""
    p_a, p_b = apply_columns(s.F, s.dN_dX[a]), apply_columns(s.F, s.dN_dX[b])
    along = s.volume * s.mu * dot(s.dN_dX[a], s.dN_dX[b])
    outers = identity_and_outers(0.0, s.volume * s.lam, p_a, p_b, s.volume * s.mu)
    return add_matrices(scale_matrix(along, outer_square(s.F)), outers)
