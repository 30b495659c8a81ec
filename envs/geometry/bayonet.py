"""A part with two lugs, and a plate with the tray that it stands in and the socket whose L-shaped slots it turns in.

The origin lies in the plane of the plate's top, in the middle of the tray; that of the part is in its lower end.
"""

from functools import cache
from math import radians, sqrt

import numpy as np
from numpy.typing import NDArray

from ..deterministic_math import sine_cosine
from ..fem.model.mesh import SurfaceMesh
from .solid import Face, Polygon, as_polygon, at_height, mitred_offset, prism_faces, rectangle, solid_from_faces

SHAFT_APOTHEM_MM = 4.5
LUG_REACH_MM = 9.5
LUG_HEIGHT_MM = 4.0
HEAD_LOW_MM, HEAD_HIGH_MM = 13.0, 39.0
HEAD_GRIPPED_MM = 30.0

TRAY_HALF_MM = (10.0, 11.0)
TRAY_DEPTH_MM = 3.0
SOCKET_X_MM = 26.0
CLEARANCE_MM = 0.7
LIP_MM = 3.0
SOCKET_DEPTH_MM = 8.5
TURN_DEG = 60.0
"""By how much the part can be turned in the socket, from where it goes in to where its lugs meet the stops."""

_PLATE_MM = rectangle(-14.0, 42.0, -17.0, 17.0)
_PLATE_THICKNESS_MM = 12.0
# An octagon's side is this times its apothem.
_SIDE = 2.0 * (sqrt(2.0) - 1.0)
LUG_HALF_WIDTH_MM = 0.5 * _SIDE * SHAFT_APOTHEM_MM
# Free space beside a lug at the stop.
_STOP_GAP_MM = 0.1
# Radii of the room below the lip, beside the lugs and where they turn, and by how much it is wider than the opening.
_INNER_MM, _OUTER_MM, _UNDERCUT_MM = 6.3, 11.5, 0.5
_INNER_PARTS, _OUTER_PARTS = 4, 5


def _octagon_mm() -> Polygon:
    """Return the shaft, counter-clockwise from the lower end of its side towards +x."""
    a, b = SHAFT_APOTHEM_MM, LUG_HALF_WIDTH_MM
    return as_polygon([(a, -b), (a, b), (b, a), (-b, a), (-a, b), (-a, -b), (-b, -a), (b, -a)])


def footprint_mm() -> Polygon:
    """Return the shaft with its lugs towards +y and -y, counter-clockwise, shape [12, 2]."""
    octagon, b, reach = _octagon_mm(), LUG_HALF_WIDTH_MM, LUG_REACH_MM
    lug = np.array([[b, reach], [-b, reach]])
    return np.concatenate([octagon[:3], lug, octagon[3:7], -lug, octagon[7:]])


def opening_mm() -> Polygon:
    """Return the opening of the socket around its own middle: the footprint with clearance."""
    return mitred_offset(footprint_mm(), CLEARANCE_MM)


@cache
def bayonet_part(head_width_mm: float) -> SurfaceMesh:
    """Return the part along z, its lower end at 0: lugs and shaft, and a head that is gripped along y.

    Args:
        head_width_mm: of the head along x [mm].
    """
    half_mm = 0.5 * head_width_mm
    head = rectangle(-half_mm, half_mm, -0.5 * HEAD_GRIPPED_MM, 0.5 * HEAD_GRIPPED_MM)
    octagon, foot = _octagon_mm(), footprint_mm()
    lower, _, *lug_walls = prism_faces(foot, 0.0, LUG_HEIGHT_MM)
    upper_lugs = [
        Face(outline_mm=at_height(foot[corners], LUG_HEIGHT_MM)) for corners in ([2, 3, 4, 5], [8, 9, 10, 11])
    ]
    shaft_walls = prism_faces(octagon, LUG_HEIGHT_MM, HEAD_LOW_MM)[2:]
    below, above, *head_walls = prism_faces(head, HEAD_LOW_MM, HEAD_HIGH_MM)
    shoulder = Face(outline_mm=below.outline_mm, holes_mm=(at_height(octagon, HEAD_LOW_MM),))
    faces = [lower, *lug_walls, *upper_lugs, *shaft_walls, shoulder, *head_walls, above]
    return solid_from_faces(faces, f"part with a head of {head_width_mm:g} mm")


@cache
def tray_and_socket() -> SurfaceMesh:
    """Return the plate; the socket's middle is at x = 26 mm."""
    socket = np.array([SOCKET_X_MM, 0.0])
    tray = rectangle(-TRAY_HALF_MM[0], TRAY_HALF_MM[0], -TRAY_HALF_MM[1], TRAY_HALF_MM[1])
    opening, room = socket + opening_mm(), socket + _room_mm()
    bottom, _, *walls = prism_faces(_PLATE_MM, -_PLATE_THICKNESS_MM, 0.0)
    top = Face(outline_mm=at_height(_PLATE_MM, 0.0), holes_mm=(at_height(tray, 0.0), at_height(opening, 0.0)))
    below_lip = Face(outline_mm=at_height(room[::-1], -LIP_MM), holes_mm=(at_height(opening, -LIP_MM),))
    inside = [
        *_inner_walls(tray, -TRAY_DEPTH_MM, 0.0),
        Face(outline_mm=at_height(tray, -TRAY_DEPTH_MM)),
        *_inner_walls(opening, -LIP_MM, 0.0),
        below_lip,
        *_inner_walls(room, -SOCKET_DEPTH_MM, -LIP_MM),
        Face(outline_mm=at_height(room, -SOCKET_DEPTH_MM)),
    ]
    return solid_from_faces([bottom, *walls, top, *inside], "tray and socket")


def _inner_walls(polygon: Polygon, low_mm: float, high_mm: float) -> list[Face]:
    return prism_faces(polygon[::-1], low_mm, high_mm)[2:]


def _room_mm() -> Polygon:
    """Return the room below the lip around its middle, counter-clockwise: each lug has a slot from its entry to a stop.

    A lug enters towards +y and turns towards -x.
    """
    entry_mm = LUG_HALF_WIDTH_MM + CLEARANCE_MM + _UNDERCUT_MM
    stop_mm = LUG_HALF_WIDTH_MM + _STOP_GAP_MM
    sine, cosine = sine_cosine(radians(TURN_DEG))
    begin = [np.array([entry_mm, _leg(radius, entry_mm)]) for radius in (_INNER_MM, _OUTER_MM)]
    # A lug at the stop points along (-sine, cosine); its far side is the one towards (-cosine, -sine).
    end = [
        _leg(radius, stop_mm) * np.array([-sine, cosine]) + stop_mm * np.array([-cosine, -sine])
        for radius in (_OUTER_MM, _INNER_MM)
    ]
    half = [*begin, *_arc(begin[1], end[0], _OUTER_PARTS), *end, *_arc(end[1], -begin[0], _INNER_PARTS)]
    return np.concatenate([half, [-corner for corner in half]])


def _leg(hypotenuse: float, other: float) -> float:
    return sqrt(hypotenuse * hypotenuse - other * other)


def _arc(first: NDArray[np.float64], last: NDArray[np.float64], parts: int) -> list[NDArray[np.float64]]:
    """Return the points between two points of a circle about the origin that divide its chord's arc nearly evenly."""
    radius = sqrt(float(first[0] * first[0] + first[1] * first[1]))
    between = [first + (part / parts) * (last - first) for part in range(1, parts)]
    return [radius / sqrt(float(point[0] * point[0] + point[1] * point[1])) * point for point in between]
