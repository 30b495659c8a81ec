"""Finds markers in a tactile picture, as the challenge's own tracker does (numbers: its ROS package)."""

from functools import cache
from importlib import import_module
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Positions = NDArray[np.float64]

WIDTH, HEIGHT = 320, 240
_BORDER: Final = 7
"""A seventh of the picture is cut off at each border."""
_MORE_ROWS_AT_THE_TOP: Final = 2
_WIDE, _NARROW = (15, 15), (9, 9)
_GAIN: Final = 16.0
_MARKER_SUM: Final = 76.0
_CLOSING: Final = 4
_MIN_DISTANCE_PX: Final = 12.0
_AREA_PX: Final = (25.0, 400.0)
_THRESHOLDS: Final = (1.0, 2.0, 0.5)
"""The challenge's thresholds reach 20, but a mask has two values: all give the same blobs, and two must agree."""


def cut_picture(picture: Picture) -> Picture:
    """Cut off the borders of a camera's picture and scale it, shape [240, 320, 3]; lens distortion stays."""
    import cv2

    rows, columns = picture.shape[0] // _BORDER, picture.shape[1] // _BORDER
    middle = picture[rows + _MORE_ROWS_AT_THE_TOP : picture.shape[0] - rows, columns : picture.shape[1] - columns]
    return np.asarray(cv2.resize(middle, (WIDTH, HEIGHT)), dtype=np.uint8)


def marker_darkness(picture: Picture) -> NDArray[np.float32]:
    """Return how much darker each pixel is than its surroundings, summed over the colours, shape [240, 320]."""
    import cv2

    wide, narrow = cv2.GaussianBlur(picture, _WIDE, 0), cv2.GaussianBlur(picture, _NARROW, 0)
    difference = cv2.convertScaleAbs(cv2.subtract(wide, narrow), alpha=_GAIN)  # both cut off at 0 and 255
    total = cv2.transform(difference.astype(np.float32), np.ones((1, 3), np.float32))
    return np.asarray(cv2.GaussianBlur(total, _WIDE, 0), dtype=np.float32)  # of the sum: that of each colour, summed


def find_markers(picture: Picture) -> Positions:
    """Return the centres of all markers of a cut picture, shape [n, 2] [pixel]."""
    return find_blobs(marker_darkness(picture))


def find_blobs(darkness: NDArray[np.float32]) -> Positions:
    """Return the centres of what is dark enough for a marker, shape [n, 2] [pixel]."""
    import cv2

    mask = (darkness > _MARKER_SUM).astype(np.uint8) * 255
    square = np.ones((3, 3), np.uint8)
    closed = cv2.erode(cv2.dilate(mask, square, iterations=_CLOSING), square, iterations=_CLOSING)
    found = _detector().detect(255 - closed)
    return np.array([blob.pt for blob in found], dtype=np.float64).reshape(-1, 2)


@cache
def _detector() -> Any:
    cv2: Any = import_module("cv2")  # its types lack these names
    settings = cv2.SimpleBlobDetector_Params()
    settings.minThreshold, settings.maxThreshold, settings.thresholdStep = _THRESHOLDS
    settings.minDistBetweenBlobs = _MIN_DISTANCE_PX
    settings.filterByArea = True
    settings.minArea, settings.maxArea = _AREA_PX
    settings.filterByCircularity = settings.filterByConvexity = settings.filterByInertia = False
    return cv2.SimpleBlobDetector_create(settings)
