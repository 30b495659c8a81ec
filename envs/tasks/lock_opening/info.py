"""What the info of the lock task holds after a reset and after every env step."""

from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class LockInfo(TypedDict):
    """The challenge's entries, in the order of its logs (challenge-facts 6.4); the base adds how the episode ended.

    Points are in the world [m], each of shape [4, 3].

    Attributes:
        steps: env steps played so far.
        key1_pts_m: top corners of the key's rear measured tooth.
        key2_pts_m: top corners of the front measured tooth.
        key_side_pts_m: corners of the key's tip.
        lock1_pts_m: lower corners of the slot for the rear tooth.
        lock2_pts_m: lower corners of the slot for the front tooth.
        lock_side_pts_m: corners of the lock's entrance face.
        surface_diff_m: mean motion of the left and the right sensing surface since the grasp [m], shape [2].
        tactile_movement_too_large: one of them is more than the task allows.
        relative_motion_mm: motion of the gripper (x, y, z) since the reset [mm], shape [3].
        error_too_large: a tooth is far out of place.
        is_success: the task is solved.
    """

    steps: int
    key1_pts_m: FloatArray
    key2_pts_m: FloatArray
    key_side_pts_m: FloatArray
    lock1_pts_m: FloatArray
    lock2_pts_m: FloatArray
    lock_side_pts_m: FloatArray
    surface_diff_m: FloatArray
    tactile_movement_too_large: bool
    relative_motion_mm: FloatArray
    error_too_large: bool
    is_success: bool
