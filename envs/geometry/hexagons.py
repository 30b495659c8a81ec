"""Regular hexagons of the fusion task: their outline, and the hexagon peg (challenge-facts 1.4)."""

from functools import cache
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from ..fem.model.mesh import SurfaceMesh
from .pegs import PEG_HEIGHT_MM
from .polygon import Polygon, as_polygon
from .solid import nearest_vertices, prism_faces, solid_from_faces

PEG_APOTHEM_MM = 15.0
# The challenge's hexagon peg reaches to x = +17 exactly, so its axis lies 0.3205 mm off its origin.
PEG_CENTRE_MM = (17.0 - 2.0 * PEG_APOTHEM_MM / sqrt(3.0), 0.0)


def regular_hexagon_mm(centre_mm: tuple[float, float], apothem_mm: float) -> Polygon:
    """Return the hexagon with two corners on its centre's line along x, counter-clockwise from the +x corner [mm].

    Args:
        centre_mm: x and y of the centre [mm].
        apothem_mm: distance of the flats from the centre [mm].
    """
    half_flat = apothem_mm / sqrt(3.0)
    x, y = centre_mm
    low, high = y - apothem_mm, y + apothem_mm
    near, far = half_flat, 2.0 * half_flat
    return as_polygon(
        [(x + far, y), (x + near, high), (x - near, high), (x - far, y), (x - near, low), (x + near, low)]
    )


@cache
def hexagon_peg_surface() -> SurfaceMesh:
    """Return the peg as a prism along z from 0 (its lower end) to 50 mm; gripped width 30 mm along y."""
    profile = regular_hexagon_mm(PEG_CENTRE_MM, PEG_APOTHEM_MM)
    return solid_from_faces(prism_faces(profile, 0.0, PEG_HEIGHT_MM), "hexagon peg")


def hexagon_bottom_vertices(peg: SurfaceMesh) -> NDArray[np.int64]:
    """Return the vertices at a hexagon peg's lower corners, in the order of `peg_relative_z_mm` (challenge-facts 1.4).

    Found by position, so the answer also fits a surface read from a file.
    """
    east, north_east, north_west, west, south_west, south_east = regular_hexagon_mm(PEG_CENTRE_MM, PEG_APOTHEM_MM)
    corners_m = np.zeros((6, 3))
    corners_m[:, :2] = np.array([south_west, west, south_east, east, north_east, north_west]) * 1e-3
    return nearest_vertices(peg, corners_m)
