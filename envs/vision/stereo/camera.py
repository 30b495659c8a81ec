"""The active stereo camera: from a scene to the depth picture that its rig would measure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..look import unit_normals
from ..optics import COLOUR_INTRINSICS, HEIGHT_PX, INFRARED_INTRINSICS, WIDTH_PX
from ..pinhole import BASELINE_M, LEFT_INFRARED_X_M, RIGHT_INFRARED_X_M, CameraPose
from ..rasterizer import NO_TRIANGLE, RenderedView, VisibleSurfaces, rasterize
from .infrared import InfraredView, Projector, dot_pattern, infrared_picture
from .matching import LARGEST_DISPARITY, MATCHES, NO_DISPARITY, PARTS, disparities, median_of_neighbours
from .method import METHOD

FloatArray = NDArray[np.float64]
DisparityMap = NDArray[np.int32]

# Ways to a neighbour whose opposite is one, too: in the row, the column, and both diagonals.
_OPPOSITE = ((0, 1), (1, 0), (1, 1), (1, -1))
_ONE_SURFACE_M = METHOD.largest_gap_difference_m
_DEPTH_TIMES_DISPARITY = INFRARED_INTRINSICS.focal_u_px * BASELINE_M * PARTS


def registered_depth_m(
    disparity: DisparityMap, first_row: int, first_column: int, shown: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Return the depth along the optical axis in the colour picture [m], 0 where unknown, shape of `shown`.

    Of several points in one pixel the nearest counts. A pixel that got none takes the nearer of two opposite neighbours
    that lie on one surface (the two cameras' pixels differ in size); beside an edge it has no depth, or near surfaces
    would grow. A pixel that shows the white background has no depth.

    Args:
        disparity: disparities in parts of a pixel, 0 for none, shape [h, w].
        first_row: row of the infrared picture in which `disparity` begins.
        first_column: its column.
        shown: triangle in every pixel of the colour picture, -1 for the background.
    """
    hit_m = np.zeros(shown.shape)
    _move_points(disparity, first_row, first_column, hit_m)
    depth_m = np.zeros(shown.shape, np.float32)
    _fill_gaps(hit_m, shown, depth_m)
    return depth_m


@large_kernel
def _move_points(disparity: DisparityMap, first_row: int, first_column: int, hit_m: FloatArray) -> None:
    """Put the depth of every disparity into the pixel of the colour picture that its point falls into."""
    infrared, colour = INFRARED_INTRINSICS, COLOUR_INTRINSICS
    for j in range(disparity.shape[0]):
        y = (first_row + j + 0.5 - infrared.centre_v_px) / infrared.focal_v_px
        row = int(np.floor(colour.focal_v_px * y + colour.centre_v_px))
        if row < 0 or row >= hit_m.shape[0]:
            continue
        for i in range(disparity.shape[1]):
            if disparity[j, i] == NO_DISPARITY:
                continue
            z = _DEPTH_TIMES_DISPARITY / disparity[j, i]
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
    colour_view: RenderedView,
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


def depth_of_pair(pair: InfraredPair, colour_view: RenderedView) -> NDArray[np.float32]:
    """Return the depth along the colour camera's axis as the stereo camera measures it [m], 0 where there is no match.

    Args:
        pair: the two pictures.
        colour_view: what the colour camera sees.
    """
    rows, columns = _exposed_part(pair.left)
    disparity = disparities(np.ascontiguousarray(pair.left[rows, columns]), _right_part(pair.right, rows, columns))
    disparity = median_of_neighbours(disparity)
    return registered_depth_m(disparity, rows.start, columns.start, colour_view.triangle)


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
