"""Affine bodies: rigid parts whose shape x = A X + t is kept orthogonal by a stiff energy.

Lan et al., Affine Body Dynamics (ACM TOG 2022), equations 4-7. A body's 12 unknowns are the positions of four *frame
points*: y_0 = A X_c + t at the centroid X_c, and y_k = y_0 + L A e_k for k = 1, 2, 3, at the distance L along each body
axis. A surface vertex is sum_k w_k y_k with fixed weights, so contact treats frame points like mesh nodes.
The columns of A are a_k = (y_k - y_0) / L.
"""

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from .mesh import SurfaceMesh
from .neo_hookean import Mat3
from .vec3 import Vec3, add, dot, load, scale, subtract

FloatArray = NDArray[np.float64]


def frame_weights(points_m: FloatArray, centroid_m: FloatArray, frame_length_m: float) -> FloatArray:
    """Weights [-] of shape [n, 4] that give body points [m] of shape [n, 3] from the frame points."""
    local = (points_m - centroid_m) / frame_length_m
    return np.concatenate([1.0 - local.sum(axis=1, keepdims=True), local], axis=1)


def frame_mass(
    mesh: SurfaceMesh,
    centroid_m: FloatArray,
    frame_length_m: float,
    density_kg_m3: float,
) -> FloatArray:
    """Consistent mass matrix rho * integral of w w^T over the solid [kg], shape [4, 4], same for each coordinate."""
    volume, _, second = mesh.moments
    about_centroid = second - volume * centroid_m[:, None] * centroid_m[None, :]
    local = about_centroid / frame_length_m**2
    mass = np.empty((4, 4))
    mass[1:, 1:] = local
    mass[0, 1:] = -local.sum(axis=0)
    mass[1:, 0] = mass[0, 1:]
    mass[0, 0] = volume + local.sum()
    return np.asarray(density_kg_m3 * mass)


@kernel
def affine_columns(y: FloatArray, first: int, frame_length: float) -> Mat3:
    """Columns of A from frame points y[first : first + 4] [m]."""
    origin = load(y, first)
    s = 1.0 / frame_length
    return (
        scale(s, subtract(load(y, first + 1), origin)),
        scale(s, subtract(load(y, first + 2), origin)),
        scale(s, subtract(load(y, first + 3), origin)),
    )


@kernel
def orthogonality_error(A: Mat3) -> Mat3:
    """Columns of A A^T - I."""
    a, b, c = A
    return (
        (
            a[0] * a[0] + b[0] * b[0] + c[0] * c[0] - 1.0,
            a[0] * a[1] + b[0] * b[1] + c[0] * c[1],
            a[0] * a[2] + b[0] * b[2] + c[0] * c[2],
        ),
        (
            a[0] * a[1] + b[0] * b[1] + c[0] * c[1],
            a[1] * a[1] + b[1] * b[1] + c[1] * c[1] - 1.0,
            a[1] * a[2] + b[1] * b[2] + c[1] * c[2],
        ),
        (
            a[0] * a[2] + b[0] * b[2] + c[0] * c[2],
            a[1] * a[2] + b[1] * b[2] + c[1] * c[2],
            a[2] * a[2] + b[2] * b[2] + c[2] * c[2] - 1.0,
        ),
    )


@kernel
def orthogonality_energy(E: Mat3) -> float:
    """|A A^T - I|_F^2 from E = A A^T - I (ABD equation 6, without its factor kappa V)."""
    return dot(E[0], E[0]) + dot(E[1], E[1]) + dot(E[2], E[2])


@kernel
def orthogonality_gradient(E: Mat3, column: Vec3) -> Vec3:
    """d|A A^T - I|^2 / da_k = 4 (A A^T - I) a_k."""
    return scale(
        4.0,
        add(add(scale(column[0], E[0]), scale(column[1], E[1])), scale(column[2], E[2])),
    )


@kernel
def orthogonality_block(E: Mat3, a_k: Vec3, a_l: Vec3, same: bool, projected: bool) -> Mat3:
    """Rows of d2|A A^T - I|^2 / da_k da_l = 4 ((a_k . a_l) I + a_l a_k^T + delta_kl (A A^T - I)).

    `projected` leaves out the last term, the only one that can be indefinite; the rest is the Gauss-Newton matrix.
    """
    d = dot(a_k, a_l)
    rows = (
        (4.0 * (d + a_l[0] * a_k[0]), 4.0 * a_l[0] * a_k[1], 4.0 * a_l[0] * a_k[2]),
        (4.0 * a_l[1] * a_k[0], 4.0 * (d + a_l[1] * a_k[1]), 4.0 * a_l[1] * a_k[2]),
        (4.0 * a_l[2] * a_k[0], 4.0 * a_l[2] * a_k[1], 4.0 * (d + a_l[2] * a_k[2])),
    )
    if same and not projected:
        return (
            add(rows[0], scale(4.0, E[0])),
            add(rows[1], scale(4.0, E[1])),
            add(rows[2], scale(4.0, E[2])),
        )
    return rows
