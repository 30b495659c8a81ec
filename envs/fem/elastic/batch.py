"""Scratch for many tetrahedra at once: what `elasticity` computes for all of them in one loop, which LLVM vectorises.

A row holds one number of every tetrahedron of the batch, and all rows stand in one array, so that the compiler knows
that no two of them overlap. The first rows are for any material; a material has rows of its own after them.
"""

from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from ..algebra.vec3 import Vec3, add, scale
from .deformation import Corners

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
