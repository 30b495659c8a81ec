"""Scratch for many tetrahedra at once: what `elasticity` computes for all of them in one loop, which LLVM vectorises.

A row holds one number of every tetrahedron of the batch, and all rows stand in one array, so that the compiler knows
that no two of them overlap.
"""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from ..algebra.vec3 import Vec3

FloatArray = NDArray[np.float64]

# Tetrahedra in a batch. Of a loop over much fewer LLVM makes a long piece of code without vectors.
BATCH = 32
# Rows, or the first of those of several vectors, three for each.
POSITION = 0  # of four corners [m]
REST_GRADIENT = 12  # of corners 1, 2 and 3 [1/m]
VOLUME = 21  # [m^3]
MU = 22  # [Pa]
LAMBDA = 23  # [Pa]
DET_F = 24
PRESSURE = 25  # lambda ln J - mu [Pa]
INVERSE_TRANSPOSE = 26  # columns of F^-T
GRADIENT = 35  # h_a = F^-T g_a of four corners [1/m]
FORCE = 47  # dE/dx_a of four corners [N]
_ROWS = 59


def new_batch() -> FloatArray:
    """Uninitialised scratch."""
    return np.empty(_ROWS * BATCH)


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
