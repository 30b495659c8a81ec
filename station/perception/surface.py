"""Notices that a gel is torn or covered: a region of its picture that is much darker or brighter than before."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .markers import Picture

Cells = NDArray[np.float32]

DAMAGED_PART: Final = 0.05
"""Part of the picture that may change so much; touch changes none (measured in tests/unit/station)."""
_CELLS: Final = (16, 12)
_CHANGE: Final = 0.5
"""Of a cell's brightness."""
_EVERY_PX: Final = 2


def measure_brightness(picture: Picture) -> Cells:
    """Return the brightness of each cell of a camera's picture, shape [12, 16]."""
    import cv2

    cells = cv2.resize(picture[::_EVERY_PX, ::_EVERY_PX], _CELLS, interpolation=cv2.INTER_AREA)
    return np.asarray(np.mean(cells, axis=2, dtype=np.float32), dtype=np.float32)


def find_changed_part(before: Cells, now: Cells) -> float:
    """Return the part of a picture whose brightness has changed by half or more."""
    return float((np.abs(now - before) >= _CHANGE * before).mean())
