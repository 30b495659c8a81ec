"""Poses of the rig's cameras, and the clouds of points of the objects that they see."""

from dataclasses import dataclass
from math import radians

import numpy as np
from numpy.typing import NDArray

from ..compilation import allocating_kernel
from ..deterministic_math import sine_cosine
from .optics import POINTS_PER_OBJECT, Intrinsics, rays

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
        z_m: 1 mm below the commanded height of the peg's lower end [m]: offset z + 6.9 mm.
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


ColourPicture = NDArray[np.uint8]
DepthPicture = NDArray[np.float32]
Draws = NDArray[np.float64]

# The challenge's colour rule: red and blue are bright above the one, red, green and blue are dark below the other.
_BRIGHT = 200
_DARK = 100


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjectClouds:
    """Points on the peg and on the base.

    Attributes:
        points_m: in the camera's frame [m], peg before base, shape [2, 128, 3]; zeros for one that is not seen.
        peg_seen: whether any pixel of the peg has a depth.
        base_seen: whether any pixel of the base has a depth.
    """

    points_m: NDArray[np.float32]
    peg_seen: bool
    base_seen: bool


def draw_points(random: np.random.Generator) -> Draws:
    """Draw which pixels become points: numbers of 0 to 1 for peg and base, shape [2, 128]."""
    return random.random((2, POINTS_PER_OBJECT))


def object_clouds(colours: ColourPicture, depth_m: DepthPicture, intrinsics: Intrinsics, draws: Draws) -> ObjectClouds:
    """Return points drawn with replacement among the pixels that the colour rule finds and that have a depth.

    The reference draws among all pixels of the colour, also those without depth, and fails where there is none; here
    the cloud is zeros then.

    Args:
        colours: red, green and blue, shape [height, width, 3].
        depth_m: of the same pixels [m], 0 for unknown, shape [height, width].
        intrinsics: of the camera.
        draws: from `draw_points`.
    """
    measured = depth_m > 0.0
    masks = (peg_pixels(colours) & measured, base_pixels(colours) & measured)
    clouds = [_drawn_points(mask, depth_m, intrinsics, drawn) for mask, drawn in zip(masks, draws, strict=True)]
    return ObjectClouds(points_m=np.stack(clouds), peg_seen=bool(masks[0].any()), base_seen=bool(masks[1].any()))


def peg_pixels(colours: ColourPicture) -> NDArray[np.bool_]:
    """Return where the challenge's rule sees the peg: red bright, green and blue dark; shape [height, width]."""
    red, green, blue = colours[:, :, 0], colours[:, :, 1], colours[:, :, 2]
    return np.asarray((red > _BRIGHT) & (green < _DARK) & (blue < _DARK))


def base_pixels(colours: ColourPicture) -> NDArray[np.bool_]:
    """Return where the challenge's rule sees the base: blue bright, green dark; shape [height, width]."""
    return np.asarray((colours[:, :, 2] > _BRIGHT) & (colours[:, :, 1] < _DARK))


def _drawn_points(
    mask: NDArray[np.bool_], depth_m: DepthPicture, intrinsics: Intrinsics, drawn: Draws
) -> NDArray[np.float32]:
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return np.zeros((POINTS_PER_OBJECT, 3), np.float32)
    chosen = (drawn * len(rows)).astype(np.int64)
    rows, columns = rows[chosen], columns[chosen]
    x, y = rays(columns, rows, intrinsics)
    z = depth_m[rows, columns]
    return np.column_stack([z * x, z * y, z]).astype(np.float32)
