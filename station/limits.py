"""Checks commands, before they are sent, and readings against the limits of a station. Called by its guard."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from vitac.envs.errors import VitacError

from .description import Limits
from .devices.force_torque import Wrench
from .devices.stage import Pose

CONTROL_PERIOD_S: Final = 0.02
"""The stage is at rest this long after a reading has passed a limit."""


LARGEST_RADIUS_MM: Final = 12.0
LARGEST_THETA_DEG: Final = 15.0
"""An action that leads further from the hole than these two ends a trial of the peg as the policy's error."""


class LimitPassed(VitacError):
    """A command or reading passes a limit of the station's file; nothing moves. The message says which."""


def check_target(limits: Limits, target: Pose) -> None:
    """Refuse a target outside of the workspace, or one that is no number.

    A straight motion between two poses of the workspace stays in it.
    """
    intervals = limits.workspace.intervals()
    for (name, (low, high)), value in zip(intervals.items(), target, strict=True):
        if not low <= value <= high:
            raise LimitPassed(
                f"Target {name} {value}: expected {low} to {high}, as the workspace in the file. Not moved."
            )


def check_speed(limits: Limits, speed_mm_s: float, rotation_deg_s: float) -> None:
    """Refuse speeds above the limits, and those that are not positive numbers."""
    for name, value, limit in (
        ("speed_mm_s", speed_mm_s, limits.speed_mm_s),
        ("rotation_deg_s", rotation_deg_s, limits.rotation_deg_s),
    ):
        if not 0 < value <= limit:
            raise LimitPassed(f"{name} {value}: expected more than 0 and at most {limit}. Not moved.")


def feed_of(start: Pose, target: Pose, speed_mm_s: float, rotation_deg_s: float) -> float:
    """Return the feed at which neither speed is passed on a straight motion, in GRBL's units.

    GRBL counts millimetres and degrees alike: the feed is the length over all four axes per minute.
    """
    shift_mm = math.dist(start[:3], target[:3])
    turn_deg = abs(target.rotation_deg - start.rotation_deg)
    duration_s = max(shift_mm / speed_mm_s, turn_deg / rotation_deg_s)
    return 60 * math.hypot(shift_mm, turn_deg) / duration_s if duration_s else 60 * speed_mm_s


def check_wrench(limits: Limits, wrench: Wrench) -> None:
    """Refuse a force or torque above its limit, and readings that are no numbers."""
    force_n, torque_nm = math.hypot(*wrench[:3]), math.hypot(*wrench[3:])
    if not force_n <= limits.force_n:
        raise LimitPassed(f"Force {force_n:.2f} N: expected at most {limits.force_n} N.")
    if not torque_nm <= limits.torque_nm:
        raise LimitPassed(f"Torque {torque_nm:.3f} N m: expected at most {limits.torque_nm} N m.")


def check_markers(limits: Limits, movement_px: NDArray[np.float64]) -> None:
    """Refuse a marker that has moved too far, shape [n, 2] [pixel], and movements that are no numbers."""
    largest_px = float(np.hypot(*movement_px.T).max(initial=0.0))
    if not largest_px <= limits.marker_movement_px:
        raise LimitPassed(f"A marker moved by {largest_px:.1f} px: expected at most {limits.marker_movement_px} px.")


def check_grip(limits: Limits, position: int, speed: int, force: int) -> None:
    """Refuse a command to the gripper that is harder than the file allows."""
    low, high = limits.gripper.position
    for name, value, lowest, highest in (
        ("position", position, low, high),
        ("speed", speed, 0, limits.gripper.speed),
        ("force", force, 0, limits.gripper.force),
    ):
        if not lowest <= value <= highest:
            raise LimitPassed(f"Gripper {name} {value}: expected {lowest} to {highest}. Not moved.")
