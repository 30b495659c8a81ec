"""Actions that bring the peg over its hole, a little above the rim, and then straight down."""

from math import radians

import numpy as np

from ...deterministic_math import sine_cosine
from ...scene.guided_motion import ActionArray, longest_action
from ..task_env import Info, Observation
from .definition import TASK

_HOVER_MM = 0.6
_DEPTH_MM = 2.0
_CLOSE = 1e-3
# Offset z at which the peg's lower end is as high as the rim.
_RIM_OFFSET_MM = 9.5


def over_the_hole_then_down(_: Observation, info: Info) -> ActionArray:
    """Take the offset away while hovering, then descend; x and y are the gripper's own axes, which turn with it."""
    x_mm, y_mm, theta_deg, z_mm = info["gt_offset_mm_deg"].tolist()
    there = max(abs(x_mm), abs(y_mm), abs(theta_deg)) < _CLOSE
    height_mm = -_DEPTH_MM if there else _HOVER_MM
    sine, cosine = sine_cosine(radians(theta_deg))
    way = (
        -cosine * x_mm - sine * y_mm,
        sine * x_mm - cosine * y_mm,
        -theta_deg,
        _RIM_OFFSET_MM + height_mm - z_mm,
    )
    return longest_action(np.array(way), np.array(TASK.action_scale))
