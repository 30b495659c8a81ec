"""Median of a disparity map's neighbourhoods, which removes single wrong matches."""

import numpy as np
from numpy.typing import NDArray

from ...compilation import large_kernel

DisparityMap = NDArray[np.int32]
_NEIGHBOURHOOD = 9


def median_of_neighbours(found: DisparityMap) -> DisparityMap:
    """Replace every disparity by the lower median of those found in its 3 x 3 neighbourhood; gaps (0) stay gaps."""
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
            for row in range(max(0, j - 1), min(height, j + 2)):
                for column in range(max(0, i - 1), min(width, i + 2)):
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
