"""Infrared pictures of a scene that the projector lights with its dots; the projector stands at the colour camera.

Every surface reflects half of what it gets: the dots, where no body stands between it and the projector, times the
cosine of their incidence, and a little even light. Nothing comes from the background.
"""

from functools import cache
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..look import draw_noise
from ..optics import Intrinsics
from ..rasterizer import NO_TRIANGLE
from .method import METHOD

# The pattern covers the directions x/z and y/z from -HALF_WIDTH to +HALF_WIDTH, wider than the colour camera's picture.
HALF_WIDTH = 0.6
TEXELS = 1440
_CELL_TEXELS = 9
_DOT_RADIUS_TEXELS = 3.0


@cache
def dot_pattern() -> NDArray[np.uint8]:
    """Return the brightness by direction, 0 to 255, shape [TEXELS, TEXELS]; rows follow y/z, columns x/z.

    One round dot of (1 - r^2/R^2)^2 lies at a random place in every cell of a square lattice, some bright, some dim;
    in a cell of the picture's centre about five pixels of the infrared cameras wide.
    """
    random = np.random.default_rng(METHOD.pattern_seed)
    cells = TEXELS // _CELL_TEXELS
    corner = np.arange(cells) * float(_CELL_TEXELS)
    rows = corner[:, None] + random.uniform(0.0, _CELL_TEXELS, (cells, cells))
    columns = corner[None, :] + random.uniform(0.0, _CELL_TEXELS, (cells, cells))
    peaks = random.uniform(100.0, 255.0, (cells, cells))
    pattern = np.zeros((TEXELS, TEXELS))
    for row_step in range(-3, 4):
        for column_step in range(-3, 4):
            _brighten(pattern, rows.ravel(), columns.ravel(), peaks.ravel(), row_step, column_step)
    return pattern.astype(np.uint8)


def _brighten(
    pattern: NDArray[np.float64],
    rows: NDArray[np.float64],
    columns: NDArray[np.float64],
    peaks: NDArray[np.float64],
    row_step: int,
    column_step: int,
) -> None:
    """Raise the texel at a step from every dot's own to that dot's brightness there, where that is brighter."""
    row, column = np.floor(rows).astype(np.int64) + row_step, np.floor(columns).astype(np.int64) + column_step
    inside = (row >= 0) & (row < TEXELS) & (column >= 0) & (column < TEXELS)
    row, column = row[inside], column[inside]
    away_y, away_x = row + 0.5 - rows[inside], column + 0.5 - columns[inside]
    share = np.maximum(0.0, 1.0 - (away_x * away_x + away_y * away_y) / _DOT_RADIUS_TEXELS**2)
    np.maximum.at(pattern, (row, column), peaks[inside] * share * share)


FloatArray = NDArray[np.float64]
TriangleMap = NDArray[np.int32]

ALBEDO = METHOD.albedo
AMBIENT = METHOD.ambient
# Speckle is a factor of a gamma distribution of mean 1; so narrow, it is normal.
SPECKLE_SD = 1.0 / sqrt(METHOD.speckle_shape)
THERMAL_SD_GREY = METHOD.thermal_sd_grey
# A surface is lit where the projector sees the same triangle in its direction, or another one this little nearer.
_SHADOW_SLACK_M = 0.0015


class InfraredView(NamedTuple):
    """What an infrared camera sees.

    Attributes:
        depth_m: along the optical axis [m], shape [height, width].
        triangle: index of the triangle at every pixel, -1 for none, shape [height, width].
        intrinsics: of the camera.
        x_m: how far it stands on the projector's right [m].
    """

    depth_m: FloatArray
    triangle: TriangleMap
    intrinsics: Intrinsics
    x_m: float


class Projector(NamedTuple):
    """What the projector throws, and onto what.

    Attributes:
        pattern: brightness by direction, shape [t, t]; see `dot_pattern`.
        depth_m: along its axis [m], shape [height, width].
        triangle: index of the triangle that it lights in every direction, -1 for none, shape [height, width].
        intrinsics: of the two maps.
    """

    pattern: NDArray[np.uint8]
    depth_m: FloatArray
    triangle: TriangleMap
    intrinsics: Intrinsics


def infrared_picture(
    seen: InfraredView, projector: Projector, normals: FloatArray, noise_key: np.uint64
) -> NDArray[np.uint8]:
    """Expose a picture: grey levels 0 to 255, 0 where nothing is seen, shape [height, width].

    Args:
        seen: what the camera sees.
        projector: the dots and what they fall on.
        normals: outward unit normals of the triangles in the cameras' axes, shape [t, 3].
        noise_key: number that the noise of all pixels is made of.
    """
    picture = np.zeros(seen.triangle.shape, dtype=np.uint8)
    _expose(seen, projector, normals, noise_key, picture)
    return picture


@large_kernel
def _expose(
    seen: InfraredView, projector: Projector, normals: FloatArray, noise_key: np.uint64, picture: NDArray[np.uint8]
) -> None:
    height, width = picture.shape
    for j in range(height):
        y = (j + 0.5 - seen.intrinsics.centre_v_px) / seen.intrinsics.focal_v_px
        for i in range(width):
            triangle = seen.triangle[j, i]
            if triangle == NO_TRIANGLE:
                continue
            z = seen.depth_m[j, i]
            # The point as the projector sees it: the same depth, further to its right by the cameras' distance.
            a = (i + 0.5 - seen.intrinsics.centre_u_px) / seen.intrinsics.focal_u_px + seen.x_m / z
            brightness = AMBIENT
            if _is_lit(projector, a, y, z, triangle):
                n = normals[triangle]
                towards = -(n[0] * a + n[1] * y + n[2]) / np.sqrt(a * a + y * y + 1.0)
                brightness += max(towards, 0.0) * _sample_pattern(projector.pattern, a, y) / 255.0
            pixel = np.uint64(j * width + i)
            speckle = 1.0 + SPECKLE_SD * draw_noise(noise_key, np.uint64(2) * pixel)
            thermal = THERMAL_SD_GREY * draw_noise(noise_key, np.uint64(2) * pixel + np.uint64(1))
            grey = 255.0 * ALBEDO * brightness * speckle + thermal
            picture[j, i] = np.uint8(min(max(grey, 0.0), 255.0))


@kernel
def _is_lit(projector: Projector, a: float, b: float, z: float, triangle: int) -> bool:
    """Return whether the dots reach a point of a triangle in direction (a, b) at depth z; beyond the maps always."""
    column = int(np.floor(projector.intrinsics.focal_u_px * a + projector.intrinsics.centre_u_px))
    row = int(np.floor(projector.intrinsics.focal_v_px * b + projector.intrinsics.centre_v_px))
    if row < 0 or column < 0 or row >= projector.triangle.shape[0] or column >= projector.triangle.shape[1]:
        return True
    first = projector.triangle[row, column]
    if first == NO_TRIANGLE:
        return True
    nearest_m: float = projector.depth_m[row, column]
    return first == triangle or nearest_m >= z - _SHADOW_SLACK_M


@kernel
def _sample_pattern(pattern: NDArray[np.uint8], a: float, b: float) -> float:
    """Return the brightness in direction (a, b), interpolated between four texels; 0 beyond the pattern."""
    texels = pattern.shape[0]
    column = (a + HALF_WIDTH) / (2.0 * HALF_WIDTH) * texels - 0.5
    row = (b + HALF_WIDTH) / (2.0 * HALF_WIDTH) * texels - 0.5
    if not (0.0 <= column < texels - 1.0 and 0.0 <= row < texels - 1.0):
        return 0.0
    i, j = int(column), int(row)
    x, y = column - i, row - j
    upper = (1.0 - x) * pattern[j, i] + x * pattern[j, i + 1]
    lower = (1.0 - x) * pattern[j + 1, i] + x * pattern[j + 1, i + 1]
    brightness: float = (1.0 - y) * upper + y * lower
    return brightness
