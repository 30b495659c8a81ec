"""Points on peg and base alone, picked out of a depth picture by colour (challenge-facts 4.1, 4.5)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .back_projection import rays
from .optics import POINTS_PER_OBJECT, Intrinsics

ColourPicture = NDArray[np.uint8]
DepthPicture = NDArray[np.float32]
Draws = NDArray[np.float64]

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


def draw_points(random: np.random.Generator) -> Draws:
    """Draw which pixels become points: numbers of 0 to 1 for peg and base, shape [2, 128]."""
    return random.random((2, POINTS_PER_OBJECT))


def object_clouds(colours: ColourPicture, depth_m: DepthPicture, intrinsics: Intrinsics, draws: Draws) -> ObjectClouds:
    """Return points drawn with replacement among the pixels that the colour rule finds and that have a depth.

    The reference draws among all pixels of the colour, also those without depth, and fails where there is none; here
    the cloud is zeros then.

    Args:
        colours: red, green and blue, shape [height, width, 3].
        depth_m: of the same pixels [m], 0 for unknown, shape [height, width].
        intrinsics: of the camera.
        draws: from `draw_points`.
    """
    measured = depth_m > 0.0
    masks = (peg_pixels(colours) & measured, base_pixels(colours) & measured)
    clouds = [_drawn_points(mask, depth_m, intrinsics, drawn) for mask, drawn in zip(masks, draws, strict=True)]
    return ObjectClouds(points_m=np.stack(clouds), peg_seen=bool(masks[0].any()), base_seen=bool(masks[1].any()))


def peg_pixels(colours: ColourPicture) -> NDArray[np.bool_]:
    """Return where the challenge's rule sees the peg: red bright, green and blue dark; shape [height, width]."""
    red, green, blue = colours[:, :, 0], colours[:, :, 1], colours[:, :, 2]
    return np.asarray((red > _BRIGHT) & (green < _DARK) & (blue < _DARK))


def base_pixels(colours: ColourPicture) -> NDArray[np.bool_]:
    """Return where the challenge's rule sees the base: blue bright, green dark; shape [height, width]."""
    return np.asarray((colours[:, :, 2] > _BRIGHT) & (colours[:, :, 1] < _DARK))


def _drawn_points(
    mask: NDArray[np.bool_], depth_m: DepthPicture, intrinsics: Intrinsics, drawn: Draws
) -> NDArray[np.float32]:
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return np.zeros((POINTS_PER_OBJECT, 3), np.float32)
    chosen = (drawn * len(rows)).astype(np.int64)
    rows, columns = rows[chosen], columns[chosen]
    x, y = rays(columns, rows, intrinsics)
    z = depth_m[rows, columns]
    return np.column_stack([z * x, z * y, z]).astype(np.float32)
