"""What the info of an insertion task holds after a reset and after every env step."""

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray


class InsertionInfo(TypedDict):
    """The challenge's entries, in the order of its logs (challenge-facts 6.4); the base adds how the episode ended.

    Attributes:
        steps: env steps played so far.
        surface_diff_m: mean motion of the left and the right sensing surface since the grasp [m], shape [2].
        tactile_movement_too_large: one of them is more than the task allows.
        too_many_steps: the env steps are used up.
        error_too_large: the commanded offset left its range.
        peg_relative_z_mm: height of each bottom corner of the peg above the rim, measured [mm], shape [n].
        is_success: the task is solved.
        relative_motion_mm_deg: commanded motion (x, y, theta, z) since the reset [mm, mm, deg, mm], shape [4].
        gt_offset_mm_deg: commanded offset from the hole (x, y, theta, and z where the action has it) [mm, mm, deg, mm].
    """

    steps: int
    surface_diff_m: NDArray[np.float64]
    tactile_movement_too_large: bool
    too_many_steps: bool
    error_too_large: bool
    peg_relative_z_mm: NDArray[np.float64]
    is_success: bool
    relative_motion_mm_deg: NDArray[np.float64]
    gt_offset_mm_deg: NDArray[np.float64]
