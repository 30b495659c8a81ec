"""The camera rig of the fusion task, like a RealSense D415: where its cameras stand (challenge-facts 4.5, 15)."""

from dataclasses import dataclass
from math import radians

import numpy as np

from ..deterministic_math import sine_cosine
from .pinhole import CameraPose

# The infrared cameras stand on the colour camera's right, with its directions.
LEFT_INFRARED_X_M = 0.0150221
RIGHT_INFRARED_X_M = 0.0700455
BASELINE_M = RIGHT_INFRARED_X_M - LEFT_INFRARED_X_M

_POSITION_X_M = 0.371
_ABOVE_PEG_M = 0.25
_BESIDE_PEG_M = 0.02
_TURN_RAD = radians(143.75)


@dataclass(frozen=True, kw_only=True)
class RigShift:
    """Departure of a rig from its nominal pose, for training with random cameras.

    Attributes:
        turn_rad: further turn about the world's y axis [rad].
        offset_m: offset of the position in the world [m].
    """

    turn_rad: float = 0.0
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


NOMINAL = RigShift()


def colour_camera_pose(y_m: float, z_m: float, shift: RigShift = NOMINAL) -> CameraPose:
    """Return the pose of the colour camera, which follows the gripper in y and z, but not in x.

    It looks along (-0.806, 0, -0.591), 36.25 degrees below the horizontal, with its up side pointing downwards.

    Args:
        y_m: commanded y of the peg [m].
        z_m: 1 mm below the commanded height of the peg's lower end [m] (challenge-facts 4.5: offset z + 6.9 mm).
        shift: departure from the nominal pose.
    """
    sine, cosine = sine_cosine(_TURN_RAD + shift.turn_rad)
    # The picture's right is -y of the mount, its down is -z, the optical axis is x; the mount is turned about y.
    right, down, forward = (0.0, -1.0, 0.0), (-sine, 0.0, -cosine), (cosine, 0.0, -sine)
    nominal_m = np.array([_POSITION_X_M, y_m + _BESIDE_PEG_M, z_m + _ABOVE_PEG_M])
    return CameraPose(
        world_from_camera=np.ascontiguousarray(np.array([right, down, forward]).T),
        position_m=nominal_m + np.array(shift.offset_m),
    )
