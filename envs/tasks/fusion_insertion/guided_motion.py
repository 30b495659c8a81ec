"""Actions that bring the peg over its hole, a little above the rim, and then straight down."""

import numpy as np

from ...scene.perspective import ActionArray, longest_action
from ..insertion.guided_motion import way_to_the_hole
from ..task_env import Info, Observation
from .definition import TASK

_HOVER_MM = 0.6
_DEPTH_MM = 2.0
_CLOSE = 1e-3
# Offset z at which the peg's lower end is as high as the rim.
_RIM_OFFSET_MM = 9.5


def guide_to_the_hole(_: Observation, info: Info) -> ActionArray:
    """Take the offset away while hovering, then descend; the gripper's own axes turn with it."""
    *horizontal, z_mm = info["gt_offset_mm_deg"].tolist()
    there = max(abs(value) for value in horizontal) < _CLOSE
    height_mm = -_DEPTH_MM if there else _HOVER_MM
    way = (*way_to_the_hole(horizontal), _RIM_OFFSET_MM + height_mm - z_mm)
    return longest_action(np.array(way), np.array(TASK.action_scale))
