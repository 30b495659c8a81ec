"""Whole arrays of shape [n, 3] at once; NumPy's expressions would make temporary ones."""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel

FloatArray = NDArray[np.float64]


@kernel
def copy_rows(source: FloatArray, target: FloatArray) -> None:
    """Write target = source."""
    for i in range(len(target)):
        for k in range(3):
            target[i, k] = source[i, k]


@kernel
def scale_rows(s: float, rows: FloatArray) -> None:
    """Write rows = s rows."""
    for i in range(len(rows)):
        for k in range(3):
            rows[i, k] = s * rows[i, k]


@kernel
def add_rows(a: FloatArray, s: float, b: FloatArray, target: FloatArray) -> None:
    """Write target = a + s b; the target may be a or b."""
    for i in range(len(target)):
        for k in range(3):
            target[i, k] = a[i, k] + s * b[i, k]


@kernel
def any_nonzero(rows: FloatArray) -> bool:
    """Return whether any component is not zero."""
    for i in range(len(rows)):
        for k in range(3):
            if rows[i, k] != 0.0:
                return True
    return False
