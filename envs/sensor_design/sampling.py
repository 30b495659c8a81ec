"""Points on triangles at which surfaces and heights are compared."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


IndexArray = NDArray[np.int64]


_SPACING_MM = 0.5


_MAX_CUTS = 64


# Where a surface would get more points, they lie further apart; its corners are always among them.
MAX_SAMPLES = 200_000


def samples_mm(corners: FloatArray) -> FloatArray:
    """Return points of all triangles, corners included, about 0.5 mm apart, shape [n, 3] [mm].

    Args:
        corners: of the triangles [mm], shape [f, 3, 3].
    """
    return samples_of_triangles_mm(corners)[0]


def samples_of_triangles_mm(corners: FloatArray) -> tuple[FloatArray, IndexArray]:
    """Return the points of `samples_mm` and the number of the triangle that each is of, shape [n]."""
    turned = _longest_side_first(corners)
    along_mm, across_mm = _extents_mm(turned)
    spacing_mm = _SPACING_MM
    cuts = _cuts(along_mm, across_mm, spacing_mm)
    while _most_samples(cuts) > MAX_SAMPLES and cuts.max() > 1:
        spacing_mm *= 2.0
        cuts = _cuts(along_mm, across_mm, spacing_mm)
    patterns, pattern = np.unique(cuts, axis=0, return_inverse=True)
    order, ends = np.argsort(pattern, kind="stable"), np.cumsum(np.bincount(pattern))
    points, numbers = [], []
    for (along, across), held in zip(patterns.tolist(), np.split(order, ends[:-1]), strict=True):
        weights = _weights(along, across)
        points.append(_combined(turned[held], weights).reshape(-1, 3))
        numbers.append(np.repeat(held, len(weights)))
    return np.concatenate(points), np.concatenate(numbers)


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


def _longest_side_first(corners: FloatArray) -> FloatArray:
    """Return the triangles' corners turned so that the first two are the ends of the longest side."""
    sides = corners - corners[:, [1, 2, 0]]
    first = (sides * sides).sum(axis=2).argmax(axis=1)
    return np.asarray(corners[np.arange(len(corners))[:, None], (first[:, None] + np.arange(3)) % 3])


def _extents_mm(turned: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the length of the first side and the distance of the third corner from it [mm], each of shape [f]."""
    side, other = turned[:, 1] - turned[:, 0], turned[:, 2] - turned[:, 0]
    normal = np.cross(side, other)
    length = np.sqrt((side * side).sum(axis=1))
    return length, np.sqrt((normal * normal).sum(axis=1)) / np.maximum(length, 1e-300)


def _cuts(along_mm: FloatArray, across_mm: FloatArray, spacing_mm: float) -> IndexArray:
    """Return in how many pieces triangles are cut along their longest side and across it, shape [f, 2]."""
    pieces = np.ceil(np.column_stack([along_mm, across_mm]) / spacing_mm)
    return np.asarray(np.clip(pieces, 1, _MAX_CUTS).astype(np.int64))


def _most_samples(cuts: IndexArray) -> int:
    return int(((cuts[:, 0] + 2) * (cuts[:, 1] + 1)).sum())


def _weights(along: int, across: int) -> FloatArray:
    """Return weights of the corners at points in rows parallel to the first side, shape [w, 3]."""
    rows = []
    for row in range(across + 1):
        third = row / across
        pieces = int(np.ceil(along * (1.0 - third)))
        second = (1.0 - third) * np.arange(pieces + 1) / max(pieces, 1)
        rows.append(np.column_stack([1.0 - third - second, second, np.full(pieces + 1, third)]))
    return np.concatenate(rows)


def _combined(corners: FloatArray, weights: FloatArray) -> FloatArray:
    """Return weighted sums of the corners of every triangle, shape [f, w, 3]."""
    return np.asarray(sum(weights[None, :, k, None] * corners[:, None, k, :] for k in range(3)))
