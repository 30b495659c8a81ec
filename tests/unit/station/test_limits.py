"""The speed of motions over all axes; `test_guard.py` has the rest of the limits."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.station.devices.stage import Pose
from vitac.station.guard import feed_of

PLACES = st.floats(-50, 50).map(lambda value: round(value, 3))
POSES = st.builds(Pose, PLACES, PLACES, PLACES, PLACES)


@given(POSES, POSES)
def test_no_axis_is_faster_than_its_limit_and_one_of_both_speeds_is_used(start: Pose, target: Pose) -> None:
    length = math.dist(start, target)
    duration_s = length / (feed_of(start, target, 3.0, 4.0) / 60)
    shift_mm, turn_deg = math.dist(start[:3], target[:3]), abs(start.rotation_deg - target.rotation_deg)
    used = max(shift_mm / 3.0, turn_deg / 4.0)
    assert duration_s == pytest.approx(used)
