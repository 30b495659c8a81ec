"""The dots that the projector throws: a picture over its directions, made from a seed (not the camera maker's own)."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

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
