"""Actions that bring the peg straight to its hole, for pictures."""

from math import radians

import numpy as np

from ...deterministic_math import sine_cosine
from ...scene.guided_motion import ActionArray, longest_action
from ..task_env import Info, Observation
from .definition import TASK


def to_the_hole(_: Observation, info: Info) -> ActionArray:
    """Take the offset away: x and y in the gripper's own axes, which turn with it, and the angle."""
    x_mm, y_mm, theta_deg = info["gt_offset_mm_deg"].tolist()
    sine, cosine = sine_cosine(radians(theta_deg))
    way = (-cosine * x_mm - sine * y_mm, sine * x_mm - cosine * y_mm, -theta_deg)
    return longest_action(np.array(way), np.array(TASK.action_scale))
