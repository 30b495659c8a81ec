"""Pegs and plates of the 2024 edition: seven profiles, and holes that are not all a widened profile."""

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from ..fem.model.mesh import SurfaceMesh
from .bases import PEG_APOTHEM_MM, PEG_CENTRE_MM, regular_hexagon_mm
from .pegs import (
    PEG_HEIGHT_MM,
    PLATE_OUTLINE_MM,
    PLATE_THICKNESS_MM,
    PROFILES_MM,
    PegShape,
    bottom_vertices,
)
from .solid import (
    Polygon,
    as_polygon,
    mitred_offset,
    nearest_vertices,
    offset_edges,
    prism_faces,
    rectangle,
    solid_from_faces,
)

CLEARANCES_MM = (0.5, 1.0, 1.5, 2.0, 2.5)
"""Of the published holes; 2 mm of `concave1`, `cuboid` and `trapezoid` alone."""
_SURFACES_CACHED = 32
# Plate of the cuboid's hole of 2 mm.
_WIDE_PLATE_MM, _WIDE_PLATE_CLEARANCE_MM = rectangle(-42.5, 42.5, -37.5, 37.5), 2.0
_OCTAGON_MM = 15.0 * (sqrt(2.0) - 1.0)
# Every edge of the hole of concave2 is this far out, but the last one, which is out by the clearance.
_CONCAVE2_MM = 2.5


class PegShape2024(StrEnum):
    """Cross-section of a peg of 2024, in the order of the edition's list of seven."""

    CONCAVE1 = "concave1"
    CONCAVE2 = "concave2"
    CONVEX = "convex"
    CUBOID = "cuboid"
    HEXAGON = "hexagon"
    OCTAGON = "octagon"
    TRAPEZOID = "trapezoid"


SHARED_SHAPES = {PegShape2024(shape): shape for shape in PegShape}
"""Those of 2025, whose pegs and holes are the same."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Form:
    """A peg of 2024 that 2025 does not have.

    Attributes:
        profile_mm: outline of the peg, counter-clockwise.
        widened_mm: outline that the hole is a widened form of, where it is not the peg's: pegs were moved to the middle
            of their width, and the hole of convex is of a peg with a longer corner.
    """

    profile_mm: Polygon
    widened_mm: Polygon


def _own_forms() -> dict[PegShape2024, _Form]:
    concave2 = as_polygon([(-15.5, -15), (14.5, -15), (22.5, -5), (9.5, 15), (-10.5, 15), (-22.5, 5), (-10.5, -5)])
    convex = as_polygon([(10.5, 15), (-9.5, 15), (-19.5, 5), (-21.5, -5), (-14.5, -15), (15.5, -15), (21.5, 5)])
    longer = as_polygon([(10, 15), (-10, 15), (-20, 5), (-22, -5), (-15, -15), (15, -15), (25, 5)])
    side, end = _OCTAGON_MM, 15.0
    octagon = as_polygon(
        [(end, -side), (end, side), (side, end), (-side, end), (-end, side), (-end, -side), (-side, -end), (side, -end)]
    )
    return {
        PegShape2024.CONCAVE2: _Form(profile_mm=concave2, widened_mm=concave2 + np.array([0.5, 0.0])),
        PegShape2024.CONVEX: _Form(profile_mm=convex, widened_mm=longer),
        PegShape2024.HEXAGON: _Form(
            profile_mm=regular_hexagon_mm(PEG_CENTRE_MM, PEG_APOTHEM_MM),
            widened_mm=regular_hexagon_mm((0.0, 0.0), PEG_APOTHEM_MM),
        ),
        PegShape2024.OCTAGON: _Form(profile_mm=octagon, widened_mm=octagon),
    }


_OWN_FORMS = _own_forms()


def profile_mm(shape: PegShape2024) -> Polygon:
    """Return the outline of a peg [mm]."""
    return PROFILES_MM[SHARED_SHAPES[shape]] if shape in SHARED_SHAPES else _OWN_FORMS[shape].profile_mm


def hole_outline_mm(shape: PegShape2024, clearance_mm: float) -> Polygon:
    """Return the outline of the through hole [mm]."""
    widened = profile_mm(shape) if shape in SHARED_SHAPES else _OWN_FORMS[shape].widened_mm
    if shape is PegShape2024.CONCAVE2:
        distances = np.full(len(widened), _CONCAVE2_MM)
        distances[-1] = clearance_mm
        return offset_edges(widened, distances)
    return mitred_offset(widened, clearance_mm)


def plate_outline_mm(shape: PegShape2024, clearance_mm: float) -> Polygon:
    """Return the outline of the plate around a hole [mm]."""
    is_wide = shape is PegShape2024.CUBOID and clearance_mm == _WIDE_PLATE_CLEARANCE_MM
    return _WIDE_PLATE_MM if is_wide else PLATE_OUTLINE_MM


@lru_cache(maxsize=_SURFACES_CACHED)
def peg_surface(shape: PegShape2024) -> SurfaceMesh:
    """Return the peg as a prism along z from 0 (its lower end) to 50 mm."""
    return solid_from_faces(prism_faces(profile_mm(shape), 0.0, PEG_HEIGHT_MM), f"{shape} peg")


@lru_cache(maxsize=_SURFACES_CACHED)
def hole_surface(shape: PegShape2024, clearance_mm: float) -> SurfaceMesh:
    """Return the plate, 20 mm thick, with the through hole; its lower face is z = 0, its centre the origin."""
    plate, hole = plate_outline_mm(shape, clearance_mm), hole_outline_mm(shape, clearance_mm)
    return solid_from_faces(prism_faces(plate, 0.0, PLATE_THICKNESS_MM, holes_mm=(hole,)), f"{shape} hole")


def bottom_vertices_2024(shape: PegShape2024, peg: SurfaceMesh) -> NDArray[np.int64]:
    """Return the vertices at the lower corners of a peg's surface, of shapes of 2025 in the order of its logs."""
    if shape in SHARED_SHAPES:
        return bottom_vertices(SHARED_SHAPES[shape], peg)
    corners_mm = profile_mm(shape)
    return nearest_vertices(peg, np.column_stack([corners_mm, np.zeros(len(corners_mm))]) * 1e-3)
