"""Base of the fusion task: a plate with two holes and two garages, for a cuboid and a hexagon.

The origin lies in the plane of the plate's top, below the centre of the rectangular hole. The garages are pockets that
widen upwards until nothing is left of their rims. Faces that lie in one plane are one face, as in the challenge's file.
"""

from functools import cache, lru_cache
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..fem.model.mesh import SurfaceMesh
from .pegs import PEG_HEIGHT_MM
from .solid import Face, Polygon, as_polygon, at_height, nearest_vertices, prism_faces, rectangle, solid_from_faces

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
    """Return the vertices at a hexagon peg's lower corners, in the order of `peg_relative_z_mm`.

    Found by position, so the answer also fits a surface read from a file.
    """
    east, north_east, north_west, west, south_west, south_east = regular_hexagon_mm(PEG_CENTRE_MM, PEG_APOTHEM_MM)
    corners_m = np.zeros((6, 3))
    corners_m[:, :2] = np.array([south_west, west, south_east, east, north_east, north_west]) * 1e-3
    return nearest_vertices(peg, corners_m)


Corners = NDArray[np.float64]

OFFICIAL_CLEARANCE_MM = 2.0
# The holes must not cut through the blocks: half width 22.5 less the peg's 15.
LARGEST_CLEARANCE_MM = 7.5
# Number of surfaces that are cached; drawn clearances are hardly met again.
_SURFACES_CACHED = 32

RIM_MM = 17.4
HOLE_FLOOR_MM = 4.4
GARAGE_TOP_MM = 17.0
PLATE_BOTTOM_MM = -2.5
HEXAGON_HOLE_Y_MM = 45.25

_PLATE_X_MM = (-92.5, 37.5)
_PLATE_Y_MM = (-22.5, 67.5)
_BLOCK_HALF_X_MM = 27.5
_BLOCK_HALF_Y_MM = 22.5
_GARAGE_X_MM = -55.0
_GARAGE_END_MM = -82.5
_HALF_PEG_X_MM = 20.0
_HALF_PEG_Y_MM = 15.0

_HEXAGON_BLOCK = regular_hexagon_mm((0.0, HEXAGON_HOLE_Y_MM), 22.5)
_HEXAGON_GARAGE = regular_hexagon_mm((_GARAGE_X_MM, HEXAGON_HOLE_Y_MM), 22.25)
# The hexagonal block overhangs the plate's edge by 0.25 mm; its slanted walls cross the edge here.
_OVERHANG_X_MM = 2.0 * 22.5 / sqrt(3.0) - (_PLATE_Y_MM[1] - HEXAGON_HOLE_Y_MM) / sqrt(3.0)


class ClearanceOutOfRange(VitacError):
    """A base cannot be made with this clearance; the message names the range."""


@lru_cache(maxsize=_SURFACES_CACHED)
def base_surface(clearance_mm: float = OFFICIAL_CLEARANCE_MM) -> SurfaceMesh:
    """Make the base whose holes are wider than their pegs by a clearance on every side.

    Args:
        clearance_mm: gap between a centred peg's flats and its hole [mm]; 2.0 is the evaluated one.

    Raises:
        ClearanceOutOfRange: the clearance is not positive, or the holes would cut through their blocks.
    """
    if not 0.0 < clearance_mm < LARGEST_CLEARANCE_MM:
        raise ClearanceOutOfRange(
            f"The clearance is {clearance_mm:g} mm, expected more than 0 and less than {LARGEST_CLEARANCE_MM:g} mm."
        )
    rectangular, hexagonal = hole_outlines_mm(clearance_mm)
    faces = [
        *_plate_faces(),
        *_rectangular_row_faces(rectangular),
        *_hexagonal_block_faces(hexagonal),
        *_hexagonal_garage_faces(),
    ]
    return solid_from_faces(faces, f"base with {clearance_mm:g} mm clearance")


def hole_outlines_mm(clearance_mm: float) -> tuple[Polygon, Polygon]:
    """Return the outlines of the rectangular and of the hexagonal hole, counter-clockwise [mm]."""
    half_x, half_y = _HALF_PEG_X_MM + clearance_mm, _HALF_PEG_Y_MM + clearance_mm
    hexagon = regular_hexagon_mm((0.0, HEXAGON_HOLE_Y_MM), _HALF_PEG_Y_MM + clearance_mm)
    return rectangle(-half_x, half_x, -half_y, half_y), hexagon


def _plate_faces() -> list[Face]:
    """Return the bottom, the two ends, and the top around the blocks."""
    (west, east), (south, north) = _PLATE_X_MM, _PLATE_Y_MM
    outline = rectangle(west, east, south, north)
    low, high = at_height(outline, PLATE_BOTTOM_MM), at_height(outline, 0.0)
    return [
        Face(outline_mm=low[::-1]),
        Face(outline_mm=np.array([low[1], low[2], high[2], high[1]])),
        Face(outline_mm=np.array([low[3], low[0], high[0], high[3]])),
        Face(outline_mm=at_height(_plate_top_mm(), 0.0)),
        _plate_north_face(),
    ]


def _plate_top_mm() -> Polygon:
    """Return the outline of what the four blocks leave free of the plate's top: they all stand at its edges."""
    (west, east), (south, north) = _PLATE_X_MM, _PLATE_Y_MM
    x, y, end = _BLOCK_HALF_X_MM, _BLOCK_HALF_Y_MM, _GARAGE_END_MM
    south_edge = [(west, south), (end, south), (end, y), (x, y), (x, south), (east, south)]
    around_block = [(_OVERHANG_X_MM, north), *_beside(_HEXAGON_BLOCK), (-_OVERHANG_X_MM, north)]
    garage_east, garage_west = _HEXAGON_GARAGE[1], _HEXAGON_GARAGE[2]
    around_garage = [garage_east, *_beside(_HEXAGON_GARAGE), garage_west]
    return np.array([*south_edge, (east, north), *around_block, *around_garage, (west, north)], dtype=np.float64)


def _beside(hexagon: Polygon) -> list[NDArray[np.float64]]:
    """Return the east, south-east, south-west and west corner of a hexagon."""
    return [hexagon[0], hexagon[5], hexagon[4], hexagon[3]]


def _plate_north_face() -> Face:
    """Return the northern edge of the plate with the flat of the hexagonal garage, in the plane y = 67.5."""
    (west, east), north = _PLATE_X_MM, _PLATE_Y_MM[1]
    garage_east, garage_west = float(_HEXAGON_GARAGE[1, 0]), float(_HEXAGON_GARAGE[2, 0])
    outline = [
        *((west, PLATE_BOTTOM_MM), (west, 0.0)),
        *((garage_west, 0.0), (garage_west, GARAGE_TOP_MM), (garage_east, GARAGE_TOP_MM), (garage_east, 0.0)),
        *((-_OVERHANG_X_MM, 0.0), (_OVERHANG_X_MM, 0.0)),
        *((east, 0.0), (east, PLATE_BOTTOM_MM)),
    ]
    return Face(outline_mm=_across_y(outline, north))


def _rectangular_row_faces(hole: Polygon) -> list[Face]:
    """Block with the rectangular hole and the garage that joins it; its southern wall is also that of the plate."""
    (west, east), south = _PLATE_X_MM, _PLATE_Y_MM[0]
    x, y, end = _BLOCK_HALF_X_MM, _BLOCK_HALF_Y_MM, _GARAGE_END_MM
    skyline = [(x, 0.0), (x, RIM_MM), (-x, RIM_MM), (-x, GARAGE_TOP_MM), (end, GARAGE_TOP_MM), (end, 0.0)]
    southern = [(west, PLATE_BOTTOM_MM), (east, PLATE_BOTTOM_MM), (east, 0.0), *skyline, (west, 0.0)]
    top = rectangle(-x, x, -y, y)
    low, high = at_height(top, 0.0), at_height(top, RIM_MM)
    garage = rectangle(end, -x, -y, y)
    step = at_height(top, GARAGE_TOP_MM)
    return [
        Face(outline_mm=_across_y(southern, south)),
        Face(outline_mm=_across_y(skyline[::-1], y)),
        Face(outline_mm=np.array([low[1], low[2], high[2], high[1]])),
        Face(outline_mm=np.array([step[3], step[0], high[0], high[3]])),
        Face(outline_mm=_wall(garage, 3, 0.0, GARAGE_TOP_MM)),
        *_blind_hole_faces(top, hole),
        *_pocket_faces(_garage_floor_mm(), garage),
    ]


def _garage_floor_mm() -> Polygon:
    """Return the floor of the rectangular garage's pocket: as large as the cuboid peg."""
    x, half_x, half_y = _GARAGE_X_MM, _HALF_PEG_X_MM, _HALF_PEG_Y_MM
    return rectangle(x - half_x, x + half_x, -half_y, half_y)


def _hexagonal_block_faces(hole: Polygon) -> list[Face]:
    """Return six walls of the block with the hexagonal hole, the underside of its overhang, rim and hole."""
    east_edge = np.array([_OVERHANG_X_MM, _PLATE_Y_MM[1], 0.0])
    west_edge = np.array([-_OVERHANG_X_MM, _PLATE_Y_MM[1], 0.0])
    walls = [_wall(_HEXAGON_BLOCK, i, 0.0, RIM_MM) for i in range(6)]
    walls[0] = np.insert(walls[0], 1, east_edge, axis=0)
    walls[2] = np.insert(walls[2], 1, west_edge, axis=0)
    corners = at_height(_HEXAGON_BLOCK, 0.0)
    underside = np.array([east_edge, west_edge, corners[2], corners[1]])
    return [
        *(Face(outline_mm=wall) for wall in walls),
        Face(outline_mm=underside),
        *_blind_hole_faces(_HEXAGON_BLOCK, hole),
    ]


def _hexagonal_garage_faces() -> list[Face]:
    """Return five outer walls (the sixth lies in the plate's northern face) and the pocket."""
    walls = [_wall(_HEXAGON_GARAGE, i, 0.0, GARAGE_TOP_MM) for i in (0, 2, 3, 4, 5)]
    floor = regular_hexagon_mm((_GARAGE_X_MM, HEXAGON_HOLE_Y_MM), _HALF_PEG_Y_MM)
    return [*(Face(outline_mm=wall) for wall in walls), *_pocket_faces(floor, _HEXAGON_GARAGE)]


def _blind_hole_faces(top: Polygon, hole: Polygon) -> list[Face]:
    """Return the rim around a hole, the hole's walls and its floor."""
    rim = Face(outline_mm=at_height(top, RIM_MM), holes_mm=(at_height(hole, RIM_MM),))
    inward = hole[::-1]
    walls = [Face(outline_mm=_wall(inward, i, HOLE_FLOOR_MM, RIM_MM)) for i in range(len(hole))]
    return [rim, *walls, Face(outline_mm=at_height(hole, HOLE_FLOOR_MM))]


def _pocket_faces(floor: Polygon, top: Polygon) -> list[Face]:
    """Return the floor and tapered walls of a garage's pocket."""
    low, high = at_height(floor, 0.0), at_height(top, GARAGE_TOP_MM)
    walls = [Face(outline_mm=np.array([low[i], low[i - 1], high[i - 1], high[i]])) for i in range(len(floor))]
    return [Face(outline_mm=low), *walls]


def _wall(polygon: Polygon, i: int, low_mm: float, high_mm: float) -> Corners:
    """Return the upright rectangle over the edge from corner i to the next, seen from outside, shape [4, 3]."""
    low, high = at_height(polygon, low_mm), at_height(polygon, high_mm)
    following = (i + 1) % len(polygon)
    return np.array([low[i], low[following], high[following], high[i]])


def _across_y(outline: list[tuple[float, float]], y_mm: float) -> Corners:
    """Return the corners (x, z) in the plane y."""
    return np.array([(x, y_mm, z) for x, z in outline])
