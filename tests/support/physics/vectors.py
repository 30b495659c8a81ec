"""Between arrays and the tuples that kernels work on, and derivatives by differences."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from vitac.envs.fem.algebra import Mat3, Vec3

FloatArray = NDArray[np.float64]


def vec3(values: ArrayLike) -> Vec3:
    """Three numbers as a tuple."""
    a, b, c = np.asarray(values, dtype=float).tolist()
    return a, b, c


def columns3(matrix: FloatArray) -> Mat3:
    """Columns of a 3 x 3 array as tuples."""
    return vec3(matrix[:, 0]), vec3(matrix[:, 1]), vec3(matrix[:, 2])


def differences(function: Callable[[FloatArray], ArrayLike], x: FloatArray, step: float) -> FloatArray:
    """Derivative of a function of an array by fourth-order central differences, shape [*f, *x]."""
    flat = x.ravel()
    parts = []
    for i in range(len(flat)):

        def at(offset: float, i: int = i) -> FloatArray:
            moved = flat.copy()
            moved[i] += offset
            return np.asarray(function(moved.reshape(x.shape)), dtype=float)

        parts.append((8.0 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12.0 * step))
    stacked = np.stack(parts, axis=-1)
    return stacked.reshape(stacked.shape[:-1] + x.shape)


def random_rotation(random: np.random.Generator) -> FloatArray:
    """A rotation matrix, uniform."""
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return np.asarray(q * np.linalg.det(q))
