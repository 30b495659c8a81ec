"""Points on triangles at which surfaces and heights are compared."""

import numpy as np
from numpy.typing import NDArray

from .surface import DrawnSurface

FloatArray = NDArray[np.float64]

_SPACING_MM = 0.5
_MAX_CUTS = 64


def samples_mm(surface: DrawnSurface) -> FloatArray:
    """Return points of all triangles, corners included, about 0.5 mm apart, shape [n, 3] [mm]."""
    corners = surface.corners_mm
    sides = corners - corners[:, [1, 2, 0]]
    longest = np.sqrt((sides * sides).sum(axis=2).max(axis=1))
    cuts = np.clip(np.ceil(longest / _SPACING_MM), 1, _MAX_CUTS).astype(np.int64)
    points = []
    for count in np.unique(cuts).tolist():
        weights = np.array(
            [(i, j, count - i - j) for i in range(count + 1) for j in range(count + 1 - i)], dtype=np.float64
        )
        held = corners[cuts == count]
        points.append(_combined(held, weights / count).reshape(-1, 3))
    return np.concatenate(points)


def pulled_corners(corners: FloatArray, distance: float) -> FloatArray:
    """Return points inside triangles, each this far from a corner on the way to the middle, or there.

    Args:
        corners: in the plane or in space, shape [f, 3, d].
        distance: in the corners' unit.

    Returns:
        Shape [f, 3, d].
    """
    middle = (corners[:, 0] + corners[:, 1] + corners[:, 2])[:, None, :] / 3.0
    way = middle - corners
    length = np.sqrt((way * way).sum(axis=2, keepdims=True))
    return np.asarray(corners + way * np.minimum(1.0, distance / np.maximum(length, 1e-300)))


def _combined(corners: FloatArray, weights: FloatArray) -> FloatArray:
    """Return weighted sums of the corners of every triangle, shape [f, w, 3]."""
    return np.asarray(sum(weights[None, :, k, None] * corners[:, None, k, :] for k in range(3)))
