"""Keys and locks of the challenge, from its dimensions."""

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from ..fem.model.mesh import SurfaceMesh
from .solid import ZX_ALONG_Y, Face, Polygon, as_polygon, prism_faces, solid_from_faces

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


BLOCK_HALF_WIDTH_MM = 20.0
BLOCK_HEIGHT_MM = 40.0
CHANNEL_START_MM = 5.0
CHANNEL_HALF_WIDTH_MM = 4.0
CHANNEL_FLOOR_MM = 10.0
CHANNEL_CEILING_MM = 30.0
OWN_CLEARANCE = 0.0
"""In place of a clearance of the slots: that of the challenge's lock, 2 mm, and 1 mm for key3."""
# Number of surfaces that are cached; drawn clearances are hardly met again.
_SURFACES_CACHED = 32


@dataclass(frozen=True, kw_only=True)
class LockDimensions:
    """Block from x = 0 to its open entrance [mm].

    Attributes:
        length_mm: x of the entrance face.
        slots_mm: x range of every tooth slot, from the end wall to the entrance.
        rear_slot: index of the slot for the key's rear measured tooth ("lock1").
        front_slot: index of the slot for the key's front measured tooth ("lock2").
    """

    length_mm: float
    slots_mm: tuple[tuple[float, float], ...]
    rear_slot: int
    front_slot: int


_TWO_SLOTS = LockDimensions(length_mm=46.0, slots_mm=((15.0, 23.0), (31.0, 39.0)), rear_slot=1, front_slot=0)
LOCKS: dict[KeyShape, LockDimensions] = {
    KeyShape.KEY1: _TWO_SLOTS,
    KeyShape.KEY2: LockDimensions(length_mm=52.0, slots_mm=((15.0, 25.0), (35.0, 45.0)), rear_slot=1, front_slot=0),
    KeyShape.KEY3: _TWO_SLOTS,
    KeyShape.KEY4: LockDimensions(
        length_mm=62.0, slots_mm=((15.0, 23.0), (31.0, 39.0), (47.0, 55.0)), rear_slot=2, front_slot=1
    ),
}


@dataclass(frozen=True, kw_only=True)
class LockControlPoints:
    """Measured corners of a lock in its own frame [m].

    Attributes:
        rear_slot_m: the four lower corners of the slot for the rear tooth ("lock1_pts"), shape [4, 3].
        front_slot_m: the four lower corners of the slot for the front tooth ("lock2_pts"), shape [4, 3].
        entrance_m: the four corners of the entrance face ("lock_side_pts"), shape [4, 3].
    """

    rear_slot_m: NDArray[np.float64]
    front_slot_m: NDArray[np.float64]
    entrance_m: NDArray[np.float64]


def lock_dimensions(shape: KeyShape, slot_clearance_mm: float = OWN_CLEARANCE) -> LockDimensions:
    """Return the dimensions of a lock whose slots leave a tooth this clearance on both sides; their middles stay."""
    lock = LOCKS[shape]
    if slot_clearance_mm == OWN_CLEARANCE:
        return lock
    halves = (0.5 * (high - low) + slot_clearance_mm for low, high in KEYS[shape].teeth_mm)
    middles = (0.5 * (low + high) for low, high in lock.slots_mm)
    slots = tuple((middle - half, middle + half) for middle, half in zip(middles, halves, strict=True))
    return replace(lock, slots_mm=slots)


@lru_cache(maxsize=_SURFACES_CACHED)
def lock_surface(shape: KeyShape, slot_clearance_mm: float = OWN_CLEARANCE) -> SurfaceMesh:
    """Return the lock block with its channel open at the entrance and its slots open at the top."""
    lock = lock_dimensions(shape, slot_clearance_mm)
    return solid_from_faces([*_outer_faces(lock), *_channel_faces(lock), *_slot_faces(lock)], f"lock of {shape}")


def lock_control_points(shape: KeyShape, slot_clearance_mm: float = OWN_CLEARANCE) -> LockControlPoints:
    """Return the measured corners of a lock in its own frame."""
    lock = lock_dimensions(shape, slot_clearance_mm)
    ceiling = (CHANNEL_CEILING_MM,)
    return LockControlPoints(
        rear_slot_m=box_corners_m(lock.slots_mm[lock.rear_slot], CHANNEL_HALF_WIDTH_MM, ceiling),
        front_slot_m=box_corners_m(lock.slots_mm[lock.front_slot], CHANNEL_HALF_WIDTH_MM, ceiling),
        entrance_m=box_corners_m((lock.length_mm,), BLOCK_HALF_WIDTH_MM, (0.0, BLOCK_HEIGHT_MM)),
    )


def _outer_faces(lock: LockDimensions) -> list[Face]:
    length, width, height = lock.length_mm, BLOCK_HALF_WIDTH_MM, BLOCK_HEIGHT_MM
    inner, floor, ceiling = CHANNEL_HALF_WIDTH_MM, CHANNEL_FLOOR_MM, CHANNEL_CEILING_MM
    opening = _across_x(length, (-inner, inner), (floor, ceiling))
    slots = tuple(_across_z(height, slot, (-inner, inner)) for slot in lock.slots_mm)
    return [
        Face(outline_mm=_across_x(0.0, (-width, width), (0.0, height))[::-1]),
        Face(outline_mm=_across_x(length, (-width, width), (0.0, height)), holes_mm=(opening,)),
        Face(outline_mm=_across_y(-width, (0.0, length), (0.0, height))[::-1]),
        Face(outline_mm=_across_y(width, (0.0, length), (0.0, height))),
        Face(outline_mm=_across_z(0.0, (0.0, length), (-width, width))[::-1]),
        Face(outline_mm=_across_z(height, (0.0, length), (-width, width)), holes_mm=slots),
    ]


def _channel_faces(lock: LockDimensions) -> list[Face]:
    """End wall, floor, ceiling between the slots, and the two side walls, which include those of the slots."""
    inner, floor, ceiling = CHANNEL_HALF_WIDTH_MM, CHANNEL_FLOOR_MM, CHANNEL_CEILING_MM
    starts = (CHANNEL_START_MM, *(high for _, high in lock.slots_mm))
    ends = (*(low for low, _ in lock.slots_mm), lock.length_mm)
    ceilings = [
        Face(outline_mm=_across_z(ceiling, (start, end), (-inner, inner))[::-1])
        for start, end in zip(starts, ends, strict=True)
    ]
    return [
        Face(outline_mm=_across_x(CHANNEL_START_MM, (-inner, inner), (floor, ceiling))),
        Face(outline_mm=_across_z(floor, (CHANNEL_START_MM, lock.length_mm), (-inner, inner))),
        *ceilings,
        Face(outline_mm=_side_wall(lock, -inner)),
        Face(outline_mm=_side_wall(lock, inner)[::-1]),
    ]


def _slot_faces(lock: LockDimensions) -> list[Face]:
    inner, heights = CHANNEL_HALF_WIDTH_MM, (CHANNEL_CEILING_MM, BLOCK_HEIGHT_MM)
    return [
        face
        for low, high in lock.slots_mm
        for face in (
            Face(outline_mm=_across_x(low, (-inner, inner), heights)),
            Face(outline_mm=_across_x(high, (-inner, inner), heights)[::-1]),
        )
    ]


def _side_wall(lock: LockDimensions, y: float) -> NDArray[np.float64]:
    """Comb outline of channel and slots in the plane y, counter-clockwise seen from +y, shape [n, 3] [mm]."""
    teeth = [
        corner
        for low, high in reversed(lock.slots_mm)
        for corner in (
            (high, CHANNEL_CEILING_MM),
            (high, BLOCK_HEIGHT_MM),
            (low, BLOCK_HEIGHT_MM),
            (low, CHANNEL_CEILING_MM),
        )
    ]
    outline = as_polygon(
        [
            (CHANNEL_START_MM, CHANNEL_FLOOR_MM),
            (lock.length_mm, CHANNEL_FLOOR_MM),
            (lock.length_mm, CHANNEL_CEILING_MM),
            *teeth,
            (CHANNEL_START_MM, CHANNEL_CEILING_MM),
        ]
    )
    corners = np.full((len(outline), 3), y)
    corners[:, 0], corners[:, 2] = outline[:, 0], outline[:, 1]
    return corners[::-1]


def _across_x(x: float, y: tuple[float, float], z: tuple[float, float]) -> NDArray[np.float64]:
    """Return the rectangle at x whose corners run counter-clockwise seen from +x, shape [4, 3]."""
    return np.array([[x, y[0], z[0]], [x, y[1], z[0]], [x, y[1], z[1]], [x, y[0], z[1]]])


def _across_y(y: float, x: tuple[float, float], z: tuple[float, float]) -> NDArray[np.float64]:
    """Return the rectangle at y whose corners run counter-clockwise seen from +y, shape [4, 3]."""
    return np.array([[x[0], y, z[0]], [x[0], y, z[1]], [x[1], y, z[1]], [x[1], y, z[0]]])


def _across_z(z: float, x: tuple[float, float], y: tuple[float, float]) -> NDArray[np.float64]:
    """Return the rectangle at z whose corners run counter-clockwise seen from +z, shape [4, 3]."""
    return np.array([[x[0], y[0], z], [x[1], y[0], z], [x[1], y[1], z], [x[0], y[1], z]])
