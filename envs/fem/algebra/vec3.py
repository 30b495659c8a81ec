"""Three-vectors as tuples of floats, which Numba keeps in registers."""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel

Vec3 = tuple[float, float, float]


@kernel
def load(rows: NDArray[np.float64], i: int) -> Vec3:
    """Return the row i of an array of shape [n, 3]."""
    return rows[i, 0], rows[i, 1], rows[i, 2]


@kernel
def add_to_row(rows: NDArray[np.float64], i: int, v: Vec3) -> None:
    """Add a vector to row i of an array of shape [n, 3]."""
    rows[i, 0] += v[0]
    rows[i, 1] += v[1]
    rows[i, 2] += v[2]


@kernel
def add(a: Vec3, b: Vec3) -> Vec3:
    """Sum a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def subtract(a: Vec3, b: Vec3) -> Vec3:
    """Return the difference a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def scale(s: float, a: Vec3) -> Vec3:
    """Return the product s a."""
    return s * a[0], s * a[1], s * a[2]


@kernel
def dot(a: Vec3, b: Vec3) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def cross(a: Vec3, b: Vec3) -> Vec3:
    """Return the vector product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@kernel
def combine(s: float, a: Vec3, t: float, b: Vec3, u: float, c: Vec3) -> Vec3:
    """Return the linear combination s a + t b + u c."""
    return (
        s * a[0] + t * b[0] + u * c[0],
        s * a[1] + t * b[1] + u * c[1],
        s * a[2] + t * b[2] + u * c[2],
    )
