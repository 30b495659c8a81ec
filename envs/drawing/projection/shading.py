"""Colours of surfaces under a light that stands still relative to the eye. Called by `scene_view`."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
# Colours, shape [k, 4] in 0 to 1, of values, shape [k].
ColourMap = Callable[[FloatArray], FloatArray]

HELD_COLOUR = (0.56, 0.65, 0.76)
FIXED_COLOUR = (0.91, 0.88, 0.82)
CUT_COLOUR = (0.82, 0.76, 0.65)

# Towards the light: to the right, upwards, and against the line of sight.
_LIGHT = np.array([0.30, 0.78, -0.55])
# How much darker a face is that no light falls on; little where its colour has a meaning.
_MATT_SHADE, _COLOURED_SHADE = 0.28, 0.12
_GLASS_OPACITY = 0.34


def lit(rgb: FloatArray, normals: FloatArray, *, matt: bool = True) -> FloatArray:
    """Return the colours of faces as the light makes them.

    Args:
        rgb: their own colours in 0 to 1, shape [3] or [k, 3].
        normals: outward unit normals as right, up and away from the eye, shape [k, 3].
        matt: False where a colour stands for a value and must stay readable.
    """
    shade = _MATT_SHADE if matt else _COLOURED_SHADE
    light = (normals @ _LIGHT).clip(0.0, 1.0)
    return np.asarray(rgb * (1.0 - shade + shade * light)[:, None])


def seen_through(glass: FloatArray, behind: FloatArray, is_glass: NDArray[np.bool_]) -> FloatArray:
    """Return two pictures, shape [height, width, 3], one over the other: the first is glass where the mask says so."""
    mixed = behind.copy()
    mixed[is_glass] = _GLASS_OPACITY * glass[is_glass] + (1.0 - _GLASS_OPACITY) * behind[is_glass]
    return mixed


def averaged(rgb: FloatArray, block: int) -> FloatArray:
    """Return the means over blocks of pixels, shape [block h, block w, 3] to [h, w, 3]."""
    height, width = rgb.shape[0] // block, rgb.shape[1] // block
    return np.asarray(rgb.reshape(height, block, width, block, 3).mean(axis=(1, 3)))
