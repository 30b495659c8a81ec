"""Median of a disparity map's neighbourhoods, which removes single wrong matches."""

import numpy as np
from numpy.typing import NDArray

from ...compilation import large_kernel
from .method import METHOD

DisparityMap = NDArray[np.int32]
_RADIUS = METHOD.median_width_px // 2
_NEIGHBOURHOOD = (2 * _RADIUS + 1) ** 2


def median_of_neighbours(found: DisparityMap) -> DisparityMap:
    """Replace every disparity by the lower median of those found in its square neighbourhood; gaps (0) stay gaps."""
    smoothed = np.zeros_like(found)
    _write_medians(found, np.empty(_NEIGHBOURHOOD, np.int32), smoothed)
    return smoothed


@large_kernel
def _write_medians(found: DisparityMap, ordered: DisparityMap, smoothed: DisparityMap) -> None:
    height, width = found.shape
    for j in range(height):
        for i in range(width):
            if found[j, i] == 0:
                continue
            count = 0
            for row in range(max(0, j - _RADIUS), min(height, j + _RADIUS + 1)):
                for column in range(max(0, i - _RADIUS), min(width, i + _RADIUS + 1)):
                    value = found[row, column]
                    if value == 0:
                        continue
                    k = count
                    while k > 0 and ordered[k - 1] > value:
                        ordered[k] = ordered[k - 1]
                        k -= 1
                    ordered[k] = value
                    count += 1
            smoothed[j, i] = ordered[(count - 1) // 2]
