"""Scratch for many tetrahedra at once, and the deformation of one.

What `elasticity` computes for all of them in one loop is vectorised by LLVM. A row holds one number of every
tetrahedron of the batch, and all rows stand in one array, so that the compiler knows that no two of them overlap. The
first rows are for any material; a material has rows of its own after them.
"""

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from ..algebra import (
    Mat3,
    Vec3,
    add,
    combine,
    cross,
    dot,
    scale,
    subtract,
)

# One vector for each of the four corners.
Corners = tuple[Vec3, Vec3, Vec3, Vec3]


@kernel
def deformation_gradient(x: Corners, dN_dX: Corners) -> Mat3:
    """Return the columns of F of a tetrahedron with corners x [m] and rest gradients of the shape functions [1/m].

    The gradient of corner 0 is taken to be minus the sum of the others.
    """
    u, v, w = subtract(x[1], x[0]), subtract(x[2], x[0]), subtract(x[3], x[0])
    g1, g2, g3 = dN_dX[1], dN_dX[2], dN_dX[3]
    return (
        combine(g1[0], u, g2[0], v, g3[0], w),
        combine(g1[1], u, g2[1], v, g3[1], w),
        combine(g1[2], u, g2[2], v, g3[2], w),
    )


@kernel
def cofactors(F: Mat3) -> tuple[Mat3, float]:
    """Return the columns of the cofactor matrix of F (J F^-T), and J = det F."""
    c0 = cross(F[1], F[2])
    return (c0, cross(F[2], F[0]), cross(F[0], F[1])), dot(F[0], c0)


FloatArray = NDArray[np.float64]


# Tetrahedra in a batch. Of a loop over much fewer LLVM makes a long piece of code without vectors.
BATCH = 32


class Rows(NamedTuple):
    """First row of each quantity of any material; a vector has three rows, a matrix nine."""

    position: int  # of four corners [m]
    rest_gradient: int  # dN/dX of corners 1, 2 and 3 [1/m]
    volume: int  # [m^3]
    mu: int  # [Pa]
    lam: int  # [Pa]
    det_f: int
    force: int  # dE/dx_a of four corners [N]
    end: int  # first row of the material's own


def first_rows(widths: Sequence[int], start: int = 0) -> list[int]:
    """Return the first rows of quantities of these widths, one after the other, and the row after the last."""
    return list(accumulate(widths, initial=start))


ROWS = Rows(*first_rows([12, 9, 1, 1, 1, 1, 12]))


def new_batch(rows: int) -> FloatArray:
    """Return uninitialised scratch with this number of rows."""
    return np.empty(rows * BATCH)


@kernel
def get_number(batch: FloatArray, row: int, i: int) -> float:
    """Return the number of tetrahedron i."""
    return float(batch[BATCH * row + i])


@kernel
def set_number(batch: FloatArray, row: int, i: int, value: float) -> None:
    """Set a number of tetrahedron i."""
    batch[BATCH * row + i] = value


@kernel
def get_vector(batch: FloatArray, first: int, k: int, i: int) -> Vec3:
    """Return the k-th of the vectors of tetrahedron i whose rows begin at `first`."""
    row = first + 3 * k
    return get_number(batch, row, i), get_number(batch, row + 1, i), get_number(batch, row + 2, i)


@kernel
def set_vector(batch: FloatArray, first: int, k: int, i: int, v: Vec3) -> None:
    """Set the k-th of the vectors of tetrahedron i whose rows begin at `first`."""
    for m in range(3):
        set_number(batch, first + 3 * k + m, i, v[m])


@kernel
def get_corners(batch: FloatArray, first: int, i: int) -> Corners:
    """Return the four vectors of tetrahedron i whose rows begin at `first`."""
    return (
        get_vector(batch, first, 0, i),
        get_vector(batch, first, 1, i),
        get_vector(batch, first, 2, i),
        get_vector(batch, first, 3, i),
    )


@kernel
def rest_gradients(batch: FloatArray, i: int) -> Corners:
    """Return dN_a/dX of the four corners of tetrahedron i [1/m], which sum to zero."""
    g1 = get_vector(batch, ROWS.rest_gradient, 0, i)
    g2 = get_vector(batch, ROWS.rest_gradient, 1, i)
    g3 = get_vector(batch, ROWS.rest_gradient, 2, i)
    return scale(-1.0, add(add(g1, g2), g3)), g1, g2, g3
