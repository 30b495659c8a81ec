"""The active stereo camera: from a scene to the depth picture that its rig would measure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..optics import COLOUR_INTRINSICS, HEIGHT_PX, INFRARED_INTRINSICS, WIDTH_PX
from ..pictures import unit_normals
from ..pinhole import CameraPose
from ..rasterizer import View, rasterize
from ..rig import LEFT_INFRARED_X_M, RIGHT_INFRARED_X_M
from ..surfaces import FloatArray, VisibleSurfaces
from .dot_pattern import dot_pattern
from .infrared import InfraredView, Projector, infrared_picture
from .matching import LARGEST_DISPARITY, MATCHES, disparities
from .median import median_of_neighbours
from .registration import registered_depth_m

Picture = NDArray[np.uint8]
NoiseKeys = NDArray[np.uint64]
# Background that is matched around what is exposed, so that no block at an object's edge is cut.
_MARGIN_PX = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class InfraredPair:
    """The two rectified pictures of one moment, grey levels of shape [height, width]; 0 is the background."""

    left: Picture
    right: Picture


def draw_noise_keys(random: np.random.Generator) -> NoiseKeys:
    """Draw what the noise of both pictures is made of: two whole numbers."""
    return random.integers(0, 2**63, 2).astype(np.uint64)


def infrared_pair(
    surfaces: VisibleSurfaces,
    vertices_m: FloatArray,
    *,
    pose: CameraPose,
    colour_view: View,
    noise_keys: NoiseKeys,
) -> InfraredPair:
    """Take the two infrared pictures.

    Args:
        surfaces: what can be seen.
        vertices_m: its vertices in the world [m], shape [n, 3].
        pose: of the colour camera.
        colour_view: what the colour camera sees there.
        noise_keys: from `draw_noise_keys`.
    """
    in_colour_m = pose.transform_to_camera(vertices_m)
    normals = unit_normals(in_colour_m, surfaces.triangles)
    projector = Projector(dot_pattern(), colour_view.depth_m, colour_view.triangle, COLOUR_INTRINSICS)
    pictures = []
    for x_m, key in zip((LEFT_INFRARED_X_M, RIGHT_INFRARED_X_M), noise_keys, strict=True):
        view = rasterize(
            pose.moved_right(x_m).transform_to_camera(vertices_m),
            surfaces.triangles,
            INFRARED_INTRINSICS,
            height_px=HEIGHT_PX,
            width_px=WIDTH_PX,
        )
        seen = InfraredView(view.depth_m, view.triangle, INFRARED_INTRINSICS, x_m)
        pictures.append(infrared_picture(seen, projector, normals, key))
    return InfraredPair(left=pictures[0], right=pictures[1])


def depth_of_pair(pair: InfraredPair, colour_view: View) -> NDArray[np.float32]:
    """Return the depth along the colour camera's axis as the stereo camera measures it [m], 0 where there is no match.

    Args:
        pair: the two pictures.
        colour_view: what the colour camera sees.
    """
    rows, columns = _exposed_part(pair.left)
    found = disparities(np.ascontiguousarray(pair.left[rows, columns]), _right_part(pair.right, rows, columns))
    found = median_of_neighbours(found)
    return registered_depth_m(found, rows.start, columns.start, colour_view.triangle)


def _exposed_part(picture: Picture) -> tuple[slice, slice]:
    """Return the rows and columns of what is not background, with a margin."""
    exposed = picture > 0
    rows, columns = np.flatnonzero(exposed.any(axis=1)), np.flatnonzero(exposed.any(axis=0))
    return _widen(rows, picture.shape[0]), _widen(columns, picture.shape[1])


def _widen(places: NDArray[np.int64], end: int) -> slice:
    """Return the range of places from the first to the last, widened by the margin; one place where there is none."""
    if len(places) == 0:
        return slice(0, 1)
    return slice(max(0, int(places[0]) - _MARGIN_PX), min(end, int(places[-1]) + 1 + _MARGIN_PX))


def _right_part(picture: Picture, rows: slice, columns: slice) -> Picture:
    """Return what the columns of the left picture can match in the right one; beyond the picture it is dark."""
    first = columns.start - LARGEST_DISPARITY
    wanted = np.arange(first, first + (columns.stop - columns.start) + MATCHES - 1)
    inside = wanted >= 0
    part = np.zeros((rows.stop - rows.start, len(wanted)), np.uint8)
    part[:, inside] = picture[rows, wanted[inside]]
    return part
