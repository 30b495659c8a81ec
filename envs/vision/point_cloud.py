"""Point clouds made of a depth picture: of all pixels, and of peg and base alone (challenge-facts 4.1, 4.5)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .pinhole import Intrinsics
from .sizes import POINTS_PER_OBJECT

ColourPicture = NDArray[np.uint8]
DepthPicture = NDArray[np.float32]

# The challenge's colour rule: red and blue are bright above the one, red, green and blue are dark below the other.
_BRIGHT = 200
_DARK = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjectClouds:
    """Points on the peg and on the base.

    Attributes:
        points_m: in the camera's frame [m], peg before base, shape [2, 128, 3]; zeros for one that is not seen.
        peg_seen: whether any pixel of the peg has a depth.
        base_seen: whether any pixel of the base has a depth.
    """

    points_m: NDArray[np.float32]
    peg_seen: bool
    base_seen: bool


def point_cloud(depth_m: DepthPicture, intrinsics: Intrinsics) -> NDArray[np.float32]:
    """Point of every pixel in the camera's frame [m], x right, y down, z forward; zeros where there is no depth.

    Args:
        depth_m: along the optical axis [m], 0 for unknown, shape [height, width].
        intrinsics: of the camera that the depth belongs to.

    Returns:
        Points of shape [height, width, 3].
    """
    height, width = depth_m.shape
    x, y = _rays(np.arange(width), np.arange(height), intrinsics)
    cloud = np.empty((height, width, 3), np.float32)
    cloud[:, :, 0] = depth_m * x[None, :]
    cloud[:, :, 1] = depth_m * y[:, None]
    cloud[:, :, 2] = depth_m
    return cloud


def object_clouds(
    colours: ColourPicture, depth_m: DepthPicture, intrinsics: Intrinsics, random: np.random.Generator
) -> ObjectClouds:
    """Points drawn with replacement among the pixels that the challenge's colour rule finds and that have a depth.

    The reference draws among all pixels of the colour, also those without depth, and fails where there is none; here
    the cloud is zeros then. As many numbers are drawn in either case.

    Args:
        colours: red, green and blue, shape [height, width, 3].
        depth_m: of the same pixels [m], 0 for unknown, shape [height, width].
        intrinsics: of the camera.
        random: the episode's generator; 128 numbers are drawn for each object.
    """
    measured = depth_m > 0.0
    masks = (peg_pixels(colours) & measured, base_pixels(colours) & measured)
    clouds = [_drawn_points(mask, depth_m, intrinsics, random) for mask in masks]
    return ObjectClouds(points_m=np.stack(clouds), peg_seen=bool(masks[0].any()), base_seen=bool(masks[1].any()))


def peg_pixels(colours: ColourPicture) -> NDArray[np.bool_]:
    """Return where the challenge's rule sees the peg: red bright, green and blue dark; shape [height, width]."""
    red, green, blue = colours[:, :, 0], colours[:, :, 1], colours[:, :, 2]
    return np.asarray((red > _BRIGHT) & (green < _DARK) & (blue < _DARK))


def base_pixels(colours: ColourPicture) -> NDArray[np.bool_]:
    """Return where the challenge's rule sees the base: blue bright, green dark; shape [height, width]."""
    return np.asarray((colours[:, :, 2] > _BRIGHT) & (colours[:, :, 1] < _DARK))


def _drawn_points(
    mask: NDArray[np.bool_], depth_m: DepthPicture, intrinsics: Intrinsics, random: np.random.Generator
) -> NDArray[np.float32]:
    drawn = random.random(POINTS_PER_OBJECT)
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return np.zeros((POINTS_PER_OBJECT, 3), np.float32)
    chosen = (drawn * len(rows)).astype(np.int64)
    rows, columns = rows[chosen], columns[chosen]
    x, y = _rays(columns, rows, intrinsics)
    z = depth_m[rows, columns]
    return np.column_stack([z * x, z * y, z]).astype(np.float32)


def _rays(
    columns: NDArray[np.int64], rows: NDArray[np.int64], intrinsics: Intrinsics
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x/z of columns and y/z of rows."""
    x = (columns.astype(np.float64) + 0.5 - intrinsics.centre_u_px) / intrinsics.focal_u_px
    y = (rows.astype(np.float64) + 0.5 - intrinsics.centre_v_px) / intrinsics.focal_v_px
    return x, y
