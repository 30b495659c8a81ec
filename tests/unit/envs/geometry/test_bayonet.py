"""A part with two lugs and its plate: measures, how it goes in, and how far it can be turned there."""

from math import cos, radians, sin

import numpy as np
import pytest
from polygon_area import signed_area
from vitac.envs.geometry.bayonet import (
    CLEARANCE_MM,
    LIP_MM,
    LUG_HEIGHT_MM,
    LUG_REACH_MM,
    SOCKET_DEPTH_MM,
    SOCKET_X_MM,
    TURN_DEG,
    bayonet_part,
    footprint_mm,
    opening_mm,
    tray_and_socket,
)
from vitac.envs.geometry.solid import Polygon, boundaries_touch, contains


def turned(degrees: float, x_mm: float = 0.0, y_mm: float = 0.0) -> Polygon:
    """The lower end of the part, turned and moved."""
    c, s = cos(radians(degrees)), sin(radians(degrees))
    return np.asarray(footprint_mm() @ np.array([[c, s], [-s, c]]) + np.array([x_mm, y_mm]))


def is_within(inner: Polygon, outer: Polygon) -> bool:
    return not boundaries_touch(inner, outer) and contains(outer, inner[0])


def room_mm() -> Polygon:
    """The socket's floor as it is in the mesh, around its own middle."""
    surface = tray_and_socket()
    corners_mm = surface.vertices_m * 1e3
    floor = corners_mm[np.abs(corners_mm[:, 2] + SOCKET_DEPTH_MM) < 1e-9, :2] - [SOCKET_X_MM, 0.0]
    return floor[np.argsort(np.arctan2(floor[:, 1], floor[:, 0]))]


def test_part_has_the_volume_of_its_lugs_shaft_and_head() -> None:
    octagon_mm2 = 8.0 * (2.0**0.5 - 1.0) * 4.5 * 4.5
    lugs_mm2 = 2.0 * (LUG_REACH_MM - 4.5) * 2.0 * (2.0**0.5 - 1.0) * 4.5
    assert signed_area(footprint_mm()) == pytest.approx(octagon_mm2 + lugs_mm2)
    expected_mm3 = LUG_HEIGHT_MM * (octagon_mm2 + lugs_mm2) + 9.0 * octagon_mm2 + 10.0 * 30.0 * 26.0
    assert bayonet_part(10.0).volume_m3 * 1e9 == pytest.approx(expected_mm3)


def test_plate_lacks_the_tray_the_opening_and_the_room_below_it() -> None:
    expected_mm3 = 56.0 * 34.0 * 12.0 - 20.0 * 22.0 * 3.0
    expected_mm3 -= LIP_MM * signed_area(opening_mm()) + (SOCKET_DEPTH_MM - LIP_MM) * signed_area(room_mm())
    assert tray_and_socket().volume_m3 * 1e9 == pytest.approx(expected_mm3)


@pytest.mark.parametrize(
    ("degrees", "x_mm", "y_mm", "fits"),
    [
        (0.0, 0.0, 0.0, True),
        (0.0, 0.95 * CLEARANCE_MM, 0.4 * CLEARANCE_MM, True),
        (0.0, 1.05 * CLEARANCE_MM, 0.0, False),
        (0.0, 0.0, -1.05 * CLEARANCE_MM, False),
        (4.0, 0.0, 0.0, True),
        (-5.0, 0.0, 0.0, False),
    ],
)
def test_part_goes_in_within_its_clearance(degrees: float, x_mm: float, y_mm: float, *, fits: bool) -> None:
    assert is_within(turned(degrees, x_mm, y_mm), opening_mm()) == fits


def test_lugs_turn_below_the_lip_from_where_they_go_in_to_their_stops() -> None:
    room = room_mm()
    assert is_within(opening_mm(), room)
    assert all(is_within(turned(degrees), room) for degrees in np.arange(-4.0, TURN_DEG + 0.1, 2.0))
    assert not is_within(turned(TURN_DEG + 1.5), room)
    assert not is_within(turned(-12.0), room)


def test_lip_is_over_both_lugs_at_the_stops() -> None:
    corners = turned(57.0)
    assert not any(contains(opening_mm(), corners[lug]) for lug in (3, 4, 9, 10))


def test_shaft_turns_within_the_opening() -> None:
    reach_mm = np.linalg.norm(footprint_mm()[[0, 1]], axis=1).max()
    assert reach_mm < 4.5 + CLEARANCE_MM
