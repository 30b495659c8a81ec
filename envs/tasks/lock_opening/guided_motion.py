"""Actions that bring the key straight to where it opens, for pictures."""

import numpy as np

from ...scene.perspective import ActionArray, longest_action
from ..task_env import Info, Observation
from .definition import TASK
from .task import SUCCESS_Z_RANGE_M

# Above the least height at which the lock opens [mm].
_LIFT_MARGIN_MM = 0.5


def out_and_up(_: Observation, info: Info) -> ActionArray:
    """Go out until the rear tooth is below its slot, and up into it, at once: the teeth rub along the ceiling."""
    tooth_m, slot_m = info["key1_pts_m"], info["lock1_pts_m"]
    inwards_mm = 1e3 * (tooth_m[:, 0].mean() - slot_m[:, 0].mean())
    down_mm = 1e3 * (tooth_m[:, 2].min() - SUCCESS_Z_RANGE_M[0]) - _LIFT_MARGIN_MM
    return longest_action(np.array([inwards_mm, down_mm]), np.array(TASK.action_scale))
