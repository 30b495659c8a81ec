"""Puts a drawn gel into the frame in which it is meshed: base at z = 0, exactly as large as the case, centred."""

import numpy as np

from .surface import DrawnSurface


def placed_on_base(surface: DrawnSurface, *, length_mm: float, width_mm: float) -> DrawnSurface:
    """Return the surface moved, and stretched by the tolerance of its base, so that its box has this length and width.

    Args:
        surface: in any place, its longer side along x, sensing face upwards.
        length_mm: extent along x.
        width_mm: extent along y.
    """
    low, extent = surface.vertices_mm.min(axis=0), surface.extent_mm
    stretch = np.array([length_mm / extent[0], width_mm / extent[1], 1.0])
    to = np.array([0.5 * length_mm, 0.5 * width_mm, 0.0])
    return DrawnSurface(vertices_mm=(surface.vertices_mm - low) * stretch - to, triangles=surface.triangles)
