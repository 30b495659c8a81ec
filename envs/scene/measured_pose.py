"""Where the held part really is: a truth for training, outside of what scores, so its bits may differ by machine."""

from math import atan2, hypot
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .grasped_scene import GraspedScene

FloatArray = NDArray[np.float64]


def held_pose_mm_deg(grasped: "GraspedScene") -> FloatArray:
    """Return where the held part is: its own origin (x, y, z) and its roll, pitch and yaw [mm, deg], shape [6].

    The turns are made about the world's axes: about x, then y, then z.
    """
    rest_m = grasped.held_surface.vertices_m
    turned, moved_m = rigid_fit(rest_m, grasped.held_vertices_m(np.arange(len(rest_m))))
    roll = atan2(turned[2, 1], turned[2, 2])
    pitch = atan2(-turned[2, 0], hypot(turned[2, 1], turned[2, 2]))
    yaw = atan2(turned[1, 0], turned[0, 0])
    return np.concatenate([moved_m * 1e3, np.degrees([roll, pitch, yaw])])


def rigid_fit(rest_m: FloatArray, world_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the rotation and the translation [m] that bring points nearest to where they are (Kabsch 1976)."""
    rest_middle_m, middle_m = rest_m.mean(axis=0), world_m.mean(axis=0)
    left, _, right = np.linalg.svd((world_m - middle_m).T @ (rest_m - rest_middle_m))
    rotation = (left * [1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return rotation, middle_m - rotation @ rest_middle_m
