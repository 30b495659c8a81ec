"""Where a pinhole camera stands.

A camera's frame has x to the right of the picture, y down and z along the optical axis. The pixel in column i and row j
is the ray through (i + 0.5, j + 0.5).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..compilation import allocating_kernel

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraPose:
    """Where a camera stands.

    Attributes:
        world_from_camera: rotation, shape [3, 3]; its columns are the picture's right, its down, and the optical axis.
        position_m: optical centre in the world [m], shape [3].
    """

    world_from_camera: FloatArray
    position_m: FloatArray

    def transform_to_camera(self, points_m: FloatArray) -> FloatArray:
        """Return the world positions in the camera's frame [m], shape [n, 3]."""
        return _is_in_frame(points_m, self.world_from_camera, self.position_m)

    def moved_right(self, distance_m: float) -> "CameraPose":
        """Make the pose with the same directions, moved to the right of the picture [m]."""
        moved_m = self.position_m + distance_m * self.world_from_camera[:, 0]
        return CameraPose(world_from_camera=self.world_from_camera, position_m=moved_m)


@allocating_kernel
def _is_in_frame(points_m: FloatArray, rotation: FloatArray, origin_m: FloatArray) -> FloatArray:
    out = np.empty((points_m.shape[0], 3))
    for i in range(points_m.shape[0]):
        x = points_m[i, 0] - origin_m[0]
        y = points_m[i, 1] - origin_m[1]
        z = points_m[i, 2] - origin_m[2]
        for k in range(3):
            out[i, k] = rotation[0, k] * x + rotation[1, k] * y + rotation[2, k] * z
    return out
