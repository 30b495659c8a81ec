"""Keys of the lock-opening task: profiles, solids and control points (challenge-facts 1.2, 1.3)."""

from dataclasses import dataclass
from enum import StrEnum
from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..fem.model.mesh import SurfaceMesh
from .polygon import Polygon, as_polygon
from .solid import ZX_ALONG_Y, prism_faces, solid_from_faces

KEY_HALF_THICKNESS_MM = 3.0
_SHAFT_HEIGHT_MM = 10.0
_TOOTH_RISE_MM = 8.0


class KeyShape(StrEnum):
    """Key with its lock; the order is the challenge's key index."""

    KEY1 = "key1"
    KEY2 = "key2"
    KEY3 = "key3"
    KEY4 = "key4"


@dataclass(frozen=True, kw_only=True)
class KeyDimensions:
    """Side view of a key in its x-z plane [mm]; the tip is at x = 0, the handle at large x.

    Attributes:
        shaft_bottom_mm: z of the shaft's underside.
        shaft_length_mm: x where the handle begins.
        teeth_mm: x range of every tooth, from the tip to the handle.
        handle_mm: corners of the handle beyond the shaft, counter-clockwise from its lower to its upper corner at
            `shaft_length_mm`.
        rear_tooth: index of the tooth behind the control points "key1".
        front_tooth: index of the tooth behind the control points "key2".
    """

    shaft_bottom_mm: float
    shaft_length_mm: float
    teeth_mm: tuple[tuple[float, float], ...]
    handle_mm: tuple[tuple[float, float], ...]
    rear_tooth: int
    front_tooth: int

    @property
    def shaft_top_mm(self) -> float:
        """Height of the shaft's upper side [mm]."""
        return self.shaft_bottom_mm + _SHAFT_HEIGHT_MM

    @property
    def tooth_top_mm(self) -> float:
        """Height of the teeth [mm]."""
        return self.shaft_top_mm + _TOOTH_RISE_MM


KEYS: dict[KeyShape, KeyDimensions] = {
    KeyShape.KEY1: KeyDimensions(
        shaft_bottom_mm=11.0,
        shaft_length_mm=60.0,
        teeth_mm=((4.0, 8.0), (20.0, 24.0)),
        handle_mm=((60.0, 6.0), (75.0, 6.0), (75.0, 26.0), (60.0, 26.0)),
        rear_tooth=1,
        front_tooth=0,
    ),
    KeyShape.KEY2: KeyDimensions(
        shaft_bottom_mm=11.0,
        shaft_length_mm=66.0,
        teeth_mm=((4.0, 10.0), (24.0, 30.0)),
        handle_mm=((66.0, 6.0), (81.0, 6.0), (81.0, 26.0), (66.0, 26.0)),
        rear_tooth=1,
        front_tooth=0,
    ),
    KeyShape.KEY3: KeyDimensions(
        shaft_bottom_mm=11.13906,
        shaft_length_mm=60.0,
        teeth_mm=((3.0, 9.0), (19.0, 25.0)),
        handle_mm=((60.0, 6.2), (75.0, 6.2), (75.0, 26.2), (60.0, 26.2)),
        rear_tooth=1,
        front_tooth=0,
    ),
    # The first of the three teeth is not measured.
    KeyShape.KEY4: KeyDimensions(
        shaft_bottom_mm=11.0,
        shaft_length_mm=76.0,
        teeth_mm=((4.0, 8.0), (20.0, 24.0), (36.0, 40.0)),
        handle_mm=((76.0, 6.0), (91.0, 16.0), (76.0, 26.0)),
        rear_tooth=2,
        front_tooth=1,
    ),
}


@dataclass(frozen=True, kw_only=True)
class KeyControlPoints:
    """Measured corners of a key in its own frame [m].

    Attributes:
        rear_tooth_m: the four top corners of the rear measured tooth ("key1_pts"), shape [4, 3].
        front_tooth_m: the four top corners of the front measured tooth ("key2_pts"), shape [4, 3].
        tip_m: the four corners of the tip ("key_side_pts"), shape [4, 3].
    """

    rear_tooth_m: NDArray[np.float64]
    front_tooth_m: NDArray[np.float64]
    tip_m: NDArray[np.float64]


def profile_mm(key: KeyDimensions) -> Polygon:
    """Return the outline of a key (x, z), counter-clockwise from the lower corner of the tip [mm], shape [n, 2]."""
    teeth = [
        corner
        for low, high in reversed(key.teeth_mm)
        for corner in (
            (high, key.shaft_top_mm),
            (high, key.tooth_top_mm),
            (low, key.tooth_top_mm),
            (low, key.shaft_top_mm),
        )
    ]
    neck_bottom = (key.shaft_length_mm, key.shaft_bottom_mm)
    neck_top = (key.shaft_length_mm, key.shaft_top_mm)
    tip_bottom, tip_top = (0.0, key.shaft_bottom_mm), (0.0, key.shaft_top_mm)
    return as_polygon([tip_bottom, neck_bottom, *key.handle_mm, neck_top, *teeth, tip_top])


@cache
def key_surface(shape: KeyShape) -> SurfaceMesh:
    """Return the key as its profile in the x-z plane, extruded along y from -3 to +3 mm."""
    # (x, z) counter-clockwise is (z, x) clockwise: swapped and reversed it is counter-clockwise seen along +y.
    profile = profile_mm(KEYS[shape])[::-1, ::-1]
    faces = prism_faces(profile, -KEY_HALF_THICKNESS_MM, KEY_HALF_THICKNESS_MM, axes=ZX_ALONG_Y)
    return solid_from_faces(faces, str(shape))


def key_control_points(shape: KeyShape) -> KeyControlPoints:
    """Return the measured corners of a key in its own frame."""
    key = KEYS[shape]
    top = (key.tooth_top_mm,)
    return KeyControlPoints(
        rear_tooth_m=box_corners_m(key.teeth_mm[key.rear_tooth], KEY_HALF_THICKNESS_MM, top),
        front_tooth_m=box_corners_m(key.teeth_mm[key.front_tooth], KEY_HALF_THICKNESS_MM, top),
        tip_m=box_corners_m((0.0,), KEY_HALF_THICKNESS_MM, (key.shaft_bottom_mm, key.shaft_top_mm)),
    )


def box_corners_m(x_mm: tuple[float, ...], half_width_mm: float, z_mm: tuple[float, ...]) -> NDArray[np.float64]:
    """Return the points at every given x and z [mm], on both sides y = -+ half width, x slowest [m], shape [n, 3]."""
    corners = [(x, y, z) for x in x_mm for y in (-half_width_mm, half_width_mm) for z in z_mm]
    return np.array(corners, dtype=np.float64) * 1e-3
