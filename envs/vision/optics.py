"""Lenses and sizes of the pictures, and points from depth by them.

The sandbox runs this file alone, too: it imports NumPy and nothing of ours.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

HEIGHT_PX = 480
WIDTH_PX = 640
POINTS_PER_OBJECT = 128
TACTILE_HEIGHT_PX = 240
TACTILE_WIDTH_PX = 320


class Intrinsics(NamedTuple):
    """Focal lengths and principal point [px]; a tuple, so that kernels take it."""

    focal_u_px: float
    focal_v_px: float
    centre_u_px: float
    centre_v_px: float


COLOUR_INTRINSICS = Intrinsics(604.3075, 604.3075, 317.2341, 233.7944)
INFRARED_INTRINSICS = Intrinsics(595.8051, 595.8051, 315.0403, 246.2687)


def point_cloud(depth_m: NDArray[np.float32], intrinsics: tuple[float, ...]) -> NDArray[np.float32]:
    """Return the point of every pixel in the camera's frame [m], x right, y down, z forward; zeros without a depth.

    Args:
        depth_m: along the optical axis [m], 0 for unknown, shape [height, width].
        intrinsics: of the camera that the depth belongs to: focal lengths and principal point in u and v [px].

    Returns:
        Points of shape [height, width, 3].
    """
    height, width = depth_m.shape
    x, y = rays(np.arange(width), np.arange(height), intrinsics)
    cloud = np.empty((height, width, 3), np.float32)
    cloud[:, :, 0] = depth_m * x[None, :]
    cloud[:, :, 1] = depth_m * y[:, None]
    cloud[:, :, 2] = depth_m
    return cloud


def rays(
    columns: NDArray[np.int64], rows: NDArray[np.int64], intrinsics: tuple[float, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x/z of columns and y/z of rows."""
    focal_u_px, focal_v_px, centre_u_px, centre_v_px = intrinsics
    x = (columns.astype(np.float64) + 0.5 - centre_u_px) / focal_u_px
    y = (rows.astype(np.float64) + 0.5 - centre_v_px) / focal_v_px
    return x, y
