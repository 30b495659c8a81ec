"""Rotations as matrices, from quaternions and as rotation vectors."""

import numpy as np


def matrix(quaternion_wxyz):
    """Return the rotation matrix of a quaternion."""
    w, x, y, z = quaternion_wxyz / np.linalg.norm(quaternion_wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def vector(rotation):
    """Return the rotation vector [rad] of a matrix; not for half turns."""
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    sine, cosine = np.linalg.norm(axis) / 2.0, (np.trace(rotation) - 1.0) / 2.0
    return axis / (2.0 * sine) * np.arctan2(sine, cosine) if sine > 1e-9 else np.zeros(3)
