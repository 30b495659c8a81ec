"""Depth of the left infrared camera, moved into the colour camera's picture."""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..optics import COLOUR_INTRINSICS, INFRARED_INTRINSICS
from ..rasterizer import NO_TRIANGLE
from ..rig import BASELINE_M, LEFT_INFRARED_X_M
from .matching import NO_DISPARITY, PARTS
from .method import METHOD

FloatArray = NDArray[np.float64]
DisparityMap = NDArray[np.int32]

# Ways to a neighbour whose opposite is one, too: in the row, the column, and both diagonals.
_OPPOSITE = ((0, 1), (1, 0), (1, 1), (1, -1))
_ONE_SURFACE_M = METHOD.largest_gap_difference_m
_DEPTH_TIMES_DISPARITY = INFRARED_INTRINSICS.focal_u_px * BASELINE_M * PARTS


def registered_depth_m(
    found: DisparityMap, first_row: int, first_column: int, shown: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Return the depth along the optical axis in the colour picture [m], 0 where unknown, shape of `shown`.

    Of several points in one pixel the nearest counts. A pixel that got none takes the nearer of two opposite neighbours
    that lie on one surface (the two cameras' pixels differ in size); beside an edge it has no depth, or near surfaces
    would grow. A pixel that shows the white background has no depth.

    Args:
        found: disparities in parts of a pixel, 0 for none, shape [h, w].
        first_row: row of the infrared picture in which `found` begins.
        first_column: its column.
        shown: triangle in every pixel of the colour picture, -1 for the background.
    """
    hit_m = np.zeros(shown.shape)
    _move_points(found, first_row, first_column, hit_m)
    depth_m = np.zeros(shown.shape, np.float32)
    _fill_gaps(hit_m, shown, depth_m)
    return depth_m


@large_kernel
def _move_points(found: DisparityMap, first_row: int, first_column: int, hit_m: FloatArray) -> None:
    """Put the depth of every disparity into the pixel of the colour picture that its point falls into."""
    infrared, colour = INFRARED_INTRINSICS, COLOUR_INTRINSICS
    for j in range(found.shape[0]):
        y = (first_row + j + 0.5 - infrared.centre_v_px) / infrared.focal_v_px
        row = int(np.floor(colour.focal_v_px * y + colour.centre_v_px))
        if row < 0 or row >= hit_m.shape[0]:
            continue
        for i in range(found.shape[1]):
            if found[j, i] == NO_DISPARITY:
                continue
            z = _DEPTH_TIMES_DISPARITY / found[j, i]
            x = (first_column + i + 0.5 - infrared.centre_u_px) / infrared.focal_u_px + LEFT_INFRARED_X_M / z
            column = int(np.floor(colour.focal_u_px * x + colour.centre_u_px))
            if 0 <= column < hit_m.shape[1] and not 0.0 < hit_m[row, column] <= z:
                hit_m[row, column] = z


@large_kernel
def _fill_gaps(hit_m: FloatArray, shown: NDArray[np.int32], depth_m: NDArray[np.float32]) -> None:
    height, width = shown.shape
    for j in range(height):
        for i in range(width):
            if shown[j, i] == NO_TRIANGLE:
                continue
            z = hit_m[j, i]
            if 0 < i < width - 1 and 0 < j < height - 1:
                for down, right in _OPPOSITE:
                    if z == 0.0:
                        z = _pick_nearer(hit_m[j - down, i - right], hit_m[j + down, i + right])
            depth_m[j, i] = z


@kernel
def _pick_nearer(before_m: float, after_m: float) -> float:
    """Return the nearer of two depths on one surface; 0 where one is unknown or they are on different ones."""
    known = before_m > 0.0 and after_m > 0.0
    return min(before_m, after_m) if known and abs(before_m - after_m) < _ONE_SURFACE_M else 0.0
