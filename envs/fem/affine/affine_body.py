"""Affine bodies: rigid parts of the shape x = A X + t, where `orthogonality` keeps A nearly a rotation.

Lan et al., Affine Body Dynamics (ACM TOG 2022), equations 4-5. A body's 12 unknowns are the positions of four *frame
points*: y_0 = A X_c + t at the centroid X_c, and y_k = y_0 + L A e_k for k = 1, 2, 3, at the distance L along each body
axis. A surface vertex is sum_k w_k y_k with fixed weights, so contact treats frame points like mesh nodes.
The columns of A are a_k = (y_k - y_0) / L.
"""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from ..algebra.mat3 import Mat3
from ..algebra.vec3 import load, scale, subtract
from ..model.mesh import SurfaceMesh

FloatArray = NDArray[np.float64]


def frame_weights(points_m: FloatArray, centroid_m: FloatArray, frame_length_m: float) -> FloatArray:
    """Return the weights [-] of shape [n, 4] that give body points [m] of shape [n, 3] from the frame points."""
    local = (points_m - centroid_m) / frame_length_m
    return np.concatenate([1.0 - local.sum(axis=1, keepdims=True), local], axis=1)


def frame_mass(
    mesh: SurfaceMesh,
    centroid_m: FloatArray,
    frame_length_m: float,
    density_kg_m3: float,
) -> FloatArray:
    """Return the consistent mass matrix rho * integral of w w^T over the solid [kg], shape [4, 4], per coordinate."""
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
    """Return the columns of A from frame points y[first : first + 4] [m]."""
    origin = load(y, first)
    s = 1.0 / frame_length
    return (
        scale(s, subtract(load(y, first + 1), origin)),
        scale(s, subtract(load(y, first + 2), origin)),
        scale(s, subtract(load(y, first + 3), origin)),
    )
