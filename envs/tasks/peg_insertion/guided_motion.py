"""Actions that bring the peg straight to its hole, for pictures."""

import numpy as np

from ...scene.perspective import ActionArray, longest_action
from ..insertion.guided_motion import way_to_the_hole
from ..task_env import Info, Observation
from .definition import TASK


def to_the_hole(_: Observation, info: Info) -> ActionArray:
    """Take the offset away."""
    return longest_action(np.array(way_to_the_hole(info["gt_offset_mm_deg"].tolist())), np.array(TASK.action_scale))
