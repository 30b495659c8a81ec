"""Pegs and plates of the insertion task: profiles, solids and measured corners."""

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from ..fem.model.mesh import SurfaceMesh
from .solid import Polygon, as_polygon, mitred_offset, nearest_vertices, prism_faces, rectangle, solid_from_faces

PEG_HEIGHT_MM = 50.0
# Extent along y of every peg between the two gels.
GRIPPED_WIDTH_MM = 30.0
PLATE_THICKNESS_MM = 20.0
CLEARANCE_MM = 1.5
PLATE_OUTLINE_MM = rectangle(-35.0, 35.0, -25.0, 25.0)

# A bulge is even between this y and its opposite.
_MIDDLE_MM = 5.0

# The waist of concave1, an hourglass: its flanks rise at 60 degrees from the ends (half width 17.5) over 10 mm.
_WAIST_MM = 17.5 - 10.0 / sqrt(3.0)


class PegShape(StrEnum):
    """Cross-section of a peg; the order is the challenge's shape index."""

    CUBOID = "cuboid"
    TRAPEZOID = "trapezoid"
    CONCAVE1 = "concave1"


@dataclass(frozen=True, kw_only=True)
class PegForm:
    """Difference of a peg and its hole from the challenge's.

    The profile is scaled along x, by a factor that depends on y, and slanted, so that the two gripped faces stay as far
    from each other as they are: `width` -+ `taper` at the ends, `bulge` more between.

    Attributes:
        width: factor at the middle of a profile without bulge.
        taper: by how much the factor differs at the ends.
        bulge: by how much the factor is larger in the middle third; it grows linearly from the ends.
        slant_mm: by how much the end at larger y lies at larger x, and the other end at smaller x.
        clearance_mm: gap between a centred peg and its hole.
    """

    width: float = 1.0
    taper: float = 0.0
    bulge: float = 0.0
    slant_mm: float = 0.0
    clearance_mm: float = CLEARANCE_MM

    def scaled(self, points_mm: Polygon) -> Polygon:
        """Return corners of the challenge's profile as they are in this form [mm]."""
        x, y = points_mm[:, 0], points_mm[:, 1]
        end = 0.5 * GRIPPED_WIDTH_MM
        part = np.minimum(1.0, (end - np.abs(y)) / (end - _MIDDLE_MM))
        factor = self.width + self.taper * y / end + self.bulge * part
        return np.column_stack([x * factor + self.slant_mm * y / end, y])

    def corners(self, points_mm: Polygon) -> Polygon:
        """Return the corners of a challenge's profile to which the form is applied; a bulge has more of them."""
        return points_mm if self.bulge == 0.0 else _with_middle_corners(points_mm)


CHALLENGE_FORM = PegForm()


def _with_middle_corners(profile_mm: Polygon) -> Polygon:
    """Return a profile with corners where its flanks enter and leave the middle third, if it has none there."""
    corners = []
    for start, end in zip(profile_mm, np.roll(profile_mm, -1, axis=0), strict=True):
        corners.append(start)
        rise = end[1] - start[1]
        if abs(rise) > 2.0 * _MIDDLE_MM:
            for y in np.sign(rise) * np.array([-_MIDDLE_MM, _MIDDLE_MM]):
                corners.append(start + (end - start) * (y - start[1]) / rise)
    return np.array(corners)


# Number of surfaces that are cached; drawn forms are hardly met again.
_SURFACES_CACHED = 32


PROFILES_MM: dict[PegShape, Polygon] = {
    PegShape.CUBOID: as_polygon([(-20, -15), (20, -15), (20, 15), (-20, 15)]),
    PegShape.TRAPEZOID: as_polygon([(-10, -15), (10, -15), (20, 15), (-20, 15)]),
    PegShape.CONCAVE1: as_polygon(
        [
            (-17.5, -15),
            (17.5, -15),
            (_WAIST_MM, -5),
            (_WAIST_MM, 5),
            (17.5, 15),
            (-17.5, 15),
            (-_WAIST_MM, 5),
            (-_WAIST_MM, -5),
        ]
    ),
}

# Order of the corners behind `peg_relative_z_mm`.
BOTTOM_CORNERS_MM: dict[PegShape, Polygon] = {
    PegShape.CUBOID: as_polygon([(20, -15), (-20, -15), (20, 15), (-20, 15)]),
    PegShape.TRAPEZOID: as_polygon([(-10, -15), (-20, 15), (10, -15), (20, 15)]),
    PegShape.CONCAVE1: as_polygon(
        [
            (-17.5, -15),
            (-_WAIST_MM, -5),
            (17.5, -15),
            (_WAIST_MM, -5),
            (_WAIST_MM, 5),
            (17.5, 15),
            (-17.5, 15),
            (-_WAIST_MM, 5),
        ]
    ),
}


def profile_mm(shape: PegShape, form: PegForm = CHALLENGE_FORM) -> Polygon:
    """Return the outline of a peg [mm]."""
    return form.scaled(form.corners(PROFILES_MM[shape]))


def hole_outline_mm(shape: PegShape, form: PegForm = CHALLENGE_FORM) -> Polygon:
    """Return the outline of the through hole: the peg's profile, widened by the clearance on every side [mm]."""
    return mitred_offset(profile_mm(shape, form), form.clearance_mm)


@lru_cache(maxsize=_SURFACES_CACHED)
def peg_surface(shape: PegShape, form: PegForm = CHALLENGE_FORM) -> SurfaceMesh:
    """Return the peg as a prism along z from 0 (its lower end) to 50 mm; origin at the centre of the profile."""
    return solid_from_faces(prism_faces(profile_mm(shape, form), 0.0, PEG_HEIGHT_MM), f"{shape} peg")


@lru_cache(maxsize=_SURFACES_CACHED)
def hole_surface(shape: PegShape, form: PegForm = CHALLENGE_FORM) -> SurfaceMesh:
    """Return the plate 70 x 50 x 20 mm with the through hole; its lower face is z = 0, its centre the origin."""
    faces = prism_faces(PLATE_OUTLINE_MM, 0.0, PLATE_THICKNESS_MM, holes_mm=(hole_outline_mm(shape, form),))
    return solid_from_faces(faces, f"{shape} hole")


def bottom_vertices(shape: PegShape, peg: SurfaceMesh, form: PegForm = CHALLENGE_FORM) -> NDArray[np.int64]:
    """Return the vertices of a peg's surface that are the corners of `BOTTOM_CORNERS_MM`, in that order.

    Found by position, so the answer also fits a surface read from a file.
    """
    corners_mm = BOTTOM_CORNERS_MM[shape] if form.bulge == 0.0 else form.corners(PROFILES_MM[shape])
    corners_m = np.zeros((len(corners_mm), 3))
    corners_m[:, :2] = form.scaled(corners_mm) * 1e-3
    return nearest_vertices(peg, corners_m)
