"""The way to the hole, for pictures."""

from collections.abc import Sequence
from math import radians

from ...deterministic_math import sine_cosine


def way_to_the_hole(offset_mm_deg: Sequence[float]) -> tuple[float, float, float]:
    """Return what takes an offset (x mm, y mm, theta deg) away: x and y in the gripper's own axes, and the angle."""
    x_mm, y_mm, theta_deg = offset_mm_deg
    sine, cosine = sine_cosine(radians(theta_deg))
    return -cosine * x_mm - sine * y_mm, sine * x_mm - cosine * y_mm, -theta_deg
