"""Affine bodies: their frame points, mass, and the potential that keeps them rigid."""

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from .algebra import (
    Mat3,
    Vec3,
    add_matrices,
    add_to_row,
    apply_columns,
    dot,
    identity_and_outers,
    load,
    scale,
    scale_matrix,
    subtract,
)
from .linear.system import BlockLayout, add_block, block_place
from .model.mesh import SurfaceMesh
from .model.model import NO_MATRIX, PROJECTED_MATRIX, Affine, NewtonSystem

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


@kernel
def add_orthogonality(affine: Affine, layout: BlockLayout, x: FloatArray, system: NewtonSystem, matrix: int) -> None:
    """Add the forces [N] and blocks [N/m] of all movable bodies at nodes x [m]."""
    for i in range(len(affine.first_node)):
        node, unknown = affine.first_node[i], affine.first_unknown[i]
        length, stiffness = affine.frame_length_m[i], affine.stiffness_j[i]
        A = affine_columns(x, node, length)
        E = orthogonality_error(A)
        for k in range(3):
            force = scale(stiffness / length, orthogonality_gradient(E, A[k]))
            add_to_row(system.gradient, node + 1 + k, force)
            add_to_row(system.gradient, node, scale(-1.0, force))
            if matrix == NO_MATRIX:
                continue
            for j in range(3):
                block = orthogonality_block(E, A[k], A[j], k == j, matrix == PROJECTED_MATRIX)
                block = scale_matrix(stiffness / (length * length), block)
                opposite = scale_matrix(-1.0, block)
                # The block acts between the differences y_k - y_0 and y_l - y_0.
                _add_unknown_block(layout, system.entries, unknown + 1 + k, unknown + 1 + j, block)
                _add_unknown_block(layout, system.entries, unknown, unknown, block)
                _add_unknown_block(layout, system.entries, unknown + 1 + k, unknown, opposite)
                _add_unknown_block(layout, system.entries, unknown, unknown + 1 + j, opposite)


@kernel
def _add_unknown_block(layout: BlockLayout, entries: FloatArray, a: int, b: int, block: Mat3) -> None:
    place, stride = block_place(layout, a, b)
    add_block(entries, place, stride, block)


@kernel
def orthogonality_error(A: Mat3) -> Mat3:
    """Return the columns of A A^T - I."""
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
    """Return |A A^T - I|_F^2 from E = A A^T - I (ABD equation 6, without its factor kappa V)."""
    return dot(E[0], E[0]) + dot(E[1], E[1]) + dot(E[2], E[2])


@kernel
def orthogonality_gradient(E: Mat3, column: Vec3) -> Vec3:
    """Return d|A A^T - I|^2 / da_k = 4 (A A^T - I) a_k."""
    return scale(4.0, apply_columns(E, column))


@kernel
def orthogonality_block(E: Mat3, a_k: Vec3, a_l: Vec3, same: bool, projected: bool) -> Mat3:
    """Return the rows of d2|A A^T - I|^2 / da_k da_l = 4 ((a_k . a_l) I + a_l a_k^T + delta_kl (A A^T - I)).

    `projected` leaves out the last term, the only one that can be indefinite; the rest is the Gauss-Newton matrix.
    """
    block = identity_and_outers(4.0 * dot(a_k, a_l), 4.0, a_l, a_k, 0.0)
    if same and not projected:
        return add_matrices(block, scale_matrix(4.0, E))
    return block
