"""Compressible neo-Hookean elasticity of one linear tetrahedron.

    psi(F) = mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2     [J/m^3],  J = det F

Sifakis & Barbic, FEM Simulation of 3D Deformable Solids (2012), section 3.4. F = sum_a x_a (dN_a/dX)^T with the rest
gradients dN_a/dX [1/m] of the linear shape functions; dN_a/dx = F^-T dN_a/dX are those at the state. The nodal gradient
and the Hessian block are

    dE/dx_a       = V ( mu F dN_a/dX + (lambda ln J - mu) dN_a/dx )
    d2E/dx_a dx_b = V ( mu (dN_a/dX . dN_b/dX) I + lambda dN_a/dx dN_b/dx^T + (mu - lambda ln J) dN_b/dx dN_a/dx^T )
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from ...deterministic_math import natural_log
from ..algebra import (
    Mat3,
    Vec3,
    add,
    add_matrices,
    apply_columns,
    dot,
    identity_and_outers,
    outer_square,
    scale,
    scale_matrix,
)
from .batch import (
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

FloatArray = NDArray[np.float64]


class _OwnRows(NamedTuple):
    """First rows in a batch of what the stiffness takes from the strain."""

    pressure: int  # lambda ln J - mu [Pa]
    inverse_transpose: int  # columns of F^-T
    gradient: int  # dN/dx of four corners [1/m]
    end: int


_OWN = _OwnRows(*first_rows([1, 9, 12], ROWS.end))
# Rows of a batch of this material.
BATCH_ROWS = _OWN.end


class Strained(NamedTuple):
    """What the stiffness of a strained tetrahedron is made of."""

    volume: float  # [m^3]
    mu: float  # [Pa]
    lam: float  # [Pa]
    pressure: float  # lambda ln J - mu [Pa]
    dN_dX: Corners  # [1/m]
    dN_dx: Corners  # [1/m]
    inverse_b: Mat3  # rows of (F F^T)^-1


def lame_parameters_pa(youngs_modulus_pa: float, poisson_ratio: float) -> tuple[float, float]:
    """Return the lame parameters (mu, lambda) [Pa]: mu = E / (2 (1 + nu)), lambda = E nu / ((1 + nu) (1 - 2 nu))."""
    mu = youngs_modulus_pa / (2.0 * (1.0 + poisson_ratio))
    lam = youngs_modulus_pa * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    return mu, lam


@kernel
def strain_energy_density(F: Mat3, J: float, mu: float, lam: float) -> float:
    """Return psi(F) [J/m^3]; J = det F must be positive."""
    log_j = natural_log(J)
    squared_norm = dot(F[0], F[0]) + dot(F[1], F[1]) + dot(F[2], F[2])
    return 0.5 * mu * (squared_norm - 3.0) - mu * log_j + 0.5 * lam * log_j * log_j


@kernel
def write_forces(batch: FloatArray, i: int) -> None:
    """Write det F and the forces of tetrahedron i of a batch, and what `strained` reads; without branches."""
    dN_dX = rest_gradients(batch, i)
    F = deformation_gradient(get_corners(batch, ROWS.position, i), dN_dX)
    cofactor, J = cofactors(F)
    volume, mu = get_number(batch, ROWS.volume, i), get_number(batch, ROWS.mu, i)
    pressure = get_number(batch, ROWS.lam, i) * natural_log(J) - mu
    inverse_transpose = scale_matrix(1.0 / J, cofactor)
    set_number(batch, ROWS.det_f, i, J)
    set_number(batch, _OWN.pressure, i, pressure)
    for k in range(3):
        set_vector(batch, _OWN.inverse_transpose, k, i, inverse_transpose[k])
    for a in range(4):
        dN_dx = apply_columns(inverse_transpose, dN_dX[a])
        set_vector(batch, _OWN.gradient, a, i, dN_dx)
        force = nodal_gradient(volume, mu, pressure, apply_columns(F, dN_dX[a]), dN_dx)
        set_vector(batch, ROWS.force, a, i, force)


@kernel
def strained(batch: FloatArray, i: int) -> Strained:
    """Return what the stiffness of tetrahedron i of a batch is made of."""
    return Strained(
        get_number(batch, ROWS.volume, i),
        get_number(batch, ROWS.mu, i),
        get_number(batch, ROWS.lam, i),
        get_number(batch, _OWN.pressure, i),
        rest_gradients(batch, i),
        get_corners(batch, _OWN.gradient, i),
        outer_square(
            (
                get_vector(batch, _OWN.inverse_transpose, 0, i),
                get_vector(batch, _OWN.inverse_transpose, 1, i),
                get_vector(batch, _OWN.inverse_transpose, 2, i),
            )
        ),
    )


@kernel
def nodal_gradient(volume: float, mu: float, pressure: float, F_dN_dX: Vec3, dN_dx: Vec3) -> Vec3:
    """Return dE/dx_a [N] from F dN_a/dX, dN_a/dx and pressure = lambda ln J - mu [Pa]."""
    return add(scale(volume * mu, F_dN_dX), scale(volume * pressure, dN_dx))


@kernel
def stiffness_block(s: Strained, a: int, b: int) -> Mat3:
    """Return the rows of d2E/dx_a dx_b [N/m]."""
    return _block(s, a, b, s.pressure)


@kernel
def projected_stiffness_block(s: Strained, a: int, b: int) -> Mat3:
    """Return the rows of a positive semi-definite replacement of `stiffness_block`.

    Only the last term of the Hessian is indefinite: with M = F^-1 dF it is q tr(M M) = q |sym M|^2 - q |skew M|^2,
    q = mu - lambda ln J. The part of the wrong sign is left out: q |sym M|^2 is kept for q > 0, |q| |skew M|^2 for
    q < 0, where |sym M|^2 = (|M|^2 + tr M M) / 2 and |skew M|^2 = (|M|^2 - tr M M) / 2.
    """
    q = -s.volume * s.pressure
    half = 0.5 * abs(q) * dot(s.dN_dX[a], s.dN_dX[b])
    return add_matrices(_block(s, a, b, -0.5 * q / s.volume), scale_matrix(half, s.inverse_b))


@kernel
def _block(s: Strained, a: int, b: int, pressure: float) -> Mat3:
    along = s.volume * s.mu * dot(s.dN_dX[a], s.dN_dX[b])
    return identity_and_outers(along, s.volume * s.lam, s.dN_dx[a], s.dN_dx[b], -s.volume * pressure)
