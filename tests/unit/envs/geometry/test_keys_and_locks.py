"""A key fits its lock: profiles, teeth below slots, a channel that is wider than the key, and measured corners."""

from itertools import pairwise

import numpy as np
import pytest
from polygon_area import signed_area
from vitac.envs.geometry.keys_and_locks import (
    BLOCK_HALF_WIDTH_MM,
    BLOCK_HEIGHT_MM,
    CHANNEL_CEILING_MM,
    CHANNEL_FLOOR_MM,
    CHANNEL_HALF_WIDTH_MM,
    CHANNEL_START_MM,
    KEY_HALF_THICKNESS_MM,
    KEYS,
    LOCKS,
    KeyShape,
    box_corners_m,
    key_control_points,
    key_surface,
    lock_control_points,
    lock_dimensions,
    lock_surface,
    profile_mm,
)
from vitac.envs.geometry.solid import contains

EACH = pytest.mark.parametrize("shape", KeyShape)


def ranges_area(ranges: tuple[tuple[float, float], ...], height: float) -> float:
    return sum(high - low for low, high in ranges) * height


@EACH
def test_a_key_has_a_shaft_teeth_and_a_handle(shape: KeyShape) -> None:
    key = KEYS[shape]
    assert key.shaft_top_mm - key.shaft_bottom_mm == pytest.approx(10.0)
    assert key.tooth_top_mm - key.shaft_top_mm == pytest.approx(8.0)
    assert all(low < high for low, high in key.teeth_mm)
    assert all(before[1] < after[0] for before, after in pairwise(key.teeth_mm))
    assert key.teeth_mm[0][0] > 0.0
    assert key.teeth_mm[-1][1] < key.shaft_length_mm
    assert key.handle_mm[0][0] == key.handle_mm[-1][0] == key.shaft_length_mm


@EACH
def test_a_profile_is_shaft_plus_teeth_plus_handle(shape: KeyShape) -> None:
    key = KEYS[shape]
    handle = signed_area(np.array(key.handle_mm))
    shaft = key.shaft_length_mm * 10.0
    assert signed_area(profile_mm(key)) == pytest.approx(shaft + ranges_area(key.teeth_mm, 8.0) + handle)


@EACH
def test_a_profile_holds_the_teeth_and_not_what_is_between_them(shape: KeyShape) -> None:
    key, profile = KEYS[shape], profile_mm(KEYS[shape])
    height = key.shaft_top_mm + 4.0
    for low, high in key.teeth_mm:
        assert contains(profile, np.array([(low + high) / 2.0, height]))
        assert not contains(profile, np.array([low - 0.5, height]))
        assert not contains(profile, np.array([high + 0.5, height]))


@EACH
def test_a_key_is_its_profile_as_thick_as_drawn(shape: KeyShape) -> None:
    surface = key_surface(shape)
    vertices_mm = surface.vertices_m * 1e3
    assert sorted(set(vertices_mm[:, 1].round(9).tolist())) == [-KEY_HALF_THICKNESS_MM, KEY_HALF_THICKNESS_MM]
    area = signed_area(profile_mm(KEYS[shape]))
    assert surface.volume_m3 * 1e9 == pytest.approx(area * 2.0 * KEY_HALF_THICKNESS_MM)
    assert surface.name == shape.value


@EACH
def test_a_lock_is_a_block_less_channel_and_slots(shape: KeyShape) -> None:
    lock = LOCKS[shape]
    block = lock.length_mm * 2.0 * BLOCK_HALF_WIDTH_MM * BLOCK_HEIGHT_MM
    channel = (lock.length_mm - CHANNEL_START_MM) * (CHANNEL_CEILING_MM - CHANNEL_FLOOR_MM)
    slots = ranges_area(lock.slots_mm, BLOCK_HEIGHT_MM - CHANNEL_CEILING_MM)
    volume = block - (channel + slots) * 2.0 * CHANNEL_HALF_WIDTH_MM
    assert lock_surface(shape).volume_m3 * 1e9 == pytest.approx(volume)
    low, high = lock_surface(shape).vertices_m.min(axis=0) * 1e3, lock_surface(shape).vertices_m.max(axis=0) * 1e3
    assert low == pytest.approx([0.0, -BLOCK_HALF_WIDTH_MM, 0.0])
    assert high == pytest.approx([lock.length_mm, BLOCK_HALF_WIDTH_MM, BLOCK_HEIGHT_MM])


@EACH
def test_a_key_fits_into_the_channel_and_each_tooth_into_a_slot(shape: KeyShape) -> None:
    key, lock = KEYS[shape], LOCKS[shape]
    assert KEY_HALF_THICKNESS_MM < CHANNEL_HALF_WIDTH_MM
    assert key.shaft_bottom_mm > CHANNEL_FLOOR_MM
    assert key.tooth_top_mm < CHANNEL_CEILING_MM
    assert len(key.teeth_mm) == len(lock.slots_mm)
    shifts = [slot[0] + slot[1] - tooth[0] - tooth[1] for tooth, slot in zip(key.teeth_mm, lock.slots_mm, strict=True)]
    assert shifts == pytest.approx([shifts[0]] * len(shifts)), "all teeth stand below their slots at once"
    for tooth, slot in zip(key.teeth_mm, lock.slots_mm, strict=True):
        assert tooth[1] - tooth[0] < slot[1] - slot[0]
    assert shifts[0] / 2.0 > CHANNEL_START_MM, "the tip stays before the end wall"


@EACH
def test_slots_lie_between_the_end_wall_and_the_entrance(shape: KeyShape) -> None:
    lock = LOCKS[shape]
    edges = [edge for slot in lock.slots_mm for edge in slot]
    assert edges == sorted(edges)
    assert edges[0] > CHANNEL_START_MM
    assert edges[-1] < lock.length_mm


@EACH
def test_the_measured_teeth_and_slots_belong_together(shape: KeyShape) -> None:
    key, lock = KEYS[shape], LOCKS[shape]
    assert (key.rear_tooth, key.front_tooth) == (lock.rear_slot, lock.front_slot)
    assert key.rear_tooth == len(key.teeth_mm) - 1
    assert key.front_tooth == key.rear_tooth - 1


@EACH
def test_measured_corners_lie_on_the_teeth_and_the_slots(shape: KeyShape) -> None:
    key, lock = KEYS[shape], LOCKS[shape]
    of_key, of_lock = key_control_points(shape), lock_control_points(shape)
    rear = of_key.rear_tooth_m * 1e3
    assert sorted(set(rear[:, 0].round(9).tolist())) == list(key.teeth_mm[key.rear_tooth])
    assert rear[:, 2] == pytest.approx(key.tooth_top_mm)
    front = of_key.front_tooth_m * 1e3
    assert sorted(set(front[:, 0].round(9).tolist())) == list(key.teeth_mm[key.front_tooth])
    assert of_key.tip_m[:, 0].tolist() == [0.0] * 4
    slot = of_lock.rear_slot_m * 1e3
    assert sorted(set(slot[:, 0].round(9).tolist())) == list(lock.slots_mm[lock.rear_slot])
    assert slot[:, 2] == pytest.approx(CHANNEL_CEILING_MM)
    assert of_lock.front_slot_m[:, 0].max() * 1e3 == pytest.approx(lock.slots_mm[lock.front_slot][1])
    assert of_lock.entrance_m[:, 0] * 1e3 == pytest.approx(lock.length_mm)


def test_corners_of_a_box_run_with_x_slowest_and_height_fastest() -> None:
    corners = box_corners_m((1.0, 2.0), 3.0, (4.0, 5.0)) * 1e3
    assert corners.round(9).tolist() == [
        [1, -3, 4],
        [1, -3, 5],
        [1, 3, 4],
        [1, 3, 5],
        [2, -3, 4],
        [2, -3, 5],
        [2, 3, 4],
        [2, 3, 5],
    ]


@EACH
def test_a_solid_is_made_once(shape: KeyShape) -> None:
    assert key_surface(shape) is key_surface(shape)
    assert lock_surface(shape) is lock_surface(shape)
    assert lock_surface(shape).name == f"lock of {shape}"


@EACH
def test_a_slot_clearance_leaves_this_on_both_sides_of_every_tooth(shape: KeyShape) -> None:
    lock = lock_dimensions(shape, 0.5)
    for slot, own, tooth in zip(lock.slots_mm, LOCKS[shape].slots_mm, KEYS[shape].teeth_mm, strict=True):
        assert slot[1] - slot[0] == pytest.approx(tooth[1] - tooth[0] + 1.0)
        assert sum(slot) == pytest.approx(sum(own))
    corners_mm = lock_control_points(shape, 0.5).rear_slot_m[:, 0] * 1e3
    assert (corners_mm.min(), corners_mm.max()) == pytest.approx(lock.slots_mm[lock.rear_slot])
    assert lock_surface(shape, 0.5).vertices_m.shape == lock_surface(shape).vertices_m.shape
