"""The gripper, its sensors and their poses, and equal parts of its motions."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..compilation import allocating_kernel
from ..deterministic_math import sine_cosine
from ..fem.model.mesh import GelMesh, MeshError

FloatArray = NDArray[np.float64]

# One on each jaw.
SENSOR_COUNT = 2


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorMount:
    """A sensor on one jaw of the gripper, at angle 0.

    Attributes:
        side: +1 for the jaw at +y of the gripper's centre, -1 for the one at -y.
        rotation: gripper from gel, shape [3, 3].
    """

    side: int
    rotation: FloatArray


# For a part that stands upright: both gels' x axes point down; the left one looks along -y, the right one along +y.
UPRIGHT_MOUNTS = (
    SensorMount(side=1, rotation=np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])),
    SensorMount(side=-1, rotation=np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])),
)


@dataclass(frozen=True, kw_only=True)
class GripperPose:
    """Pose of the gripper in the world.

    Attributes:
        x_m: centre between the jaws [m].
        y_m: [m].
        z_m: [m].
        angle_rad: rotation about the vertical [rad].
        half_opening_m: distance of each gel's centre from the gripper's centre [m].
    """

    x_m: float
    y_m: float
    z_m: float
    angle_rad: float
    half_opening_m: float

    def moved(
        self, *, x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0, angle_rad: float = 0.0, closing_m: float = 0.0
    ) -> "GripperPose":
        """Return the pose after a translation [m], a turn about its own centre [rad] and a closing of each jaw [m]."""
        return GripperPose(
            x_m=self.x_m + x_m,
            y_m=self.y_m + y_m,
            z_m=self.z_m + z_m,
            angle_rad=self.angle_rad + angle_rad,
            half_opening_m=self.half_opening_m - closing_m,
        )

    def towards(self, goal: "GripperPose", part: int, parts: int) -> "GripperPose":
        """Return the pose `part` of `parts` equal pieces on the way to the goal; the goal itself at the end."""
        if part == parts:
            return goal
        fraction = part / parts
        return GripperPose(
            x_m=self.x_m + fraction * (goal.x_m - self.x_m),
            y_m=self.y_m + fraction * (goal.y_m - self.y_m),
            z_m=self.z_m + fraction * (goal.z_m - self.z_m),
            angle_rad=self.angle_rad + fraction * (goal.angle_rad - self.angle_rad),
            half_opening_m=self.half_opening_m + fraction * (goal.half_opening_m - self.half_opening_m),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class SensorPose:
    """Pose of a gel in the world: world = rotation @ gel + centre.

    Attributes:
        rotation: shape [3, 3].
        centre_m: [m], shape [3].
    """

    rotation: FloatArray
    centre_m: FloatArray


class Gripper:
    """Two mounted gels and the pose they share.

    Attributes:
        gel: mesh of both.
        pose: present pose.

    Raises:
        MeshError: the gel has no driven nodes.
    """

    def __init__(self, *, mounts: tuple[SensorMount, SensorMount], gel: GelMesh, pose: GripperPose) -> None:
        if gel.is_free:
            raise MeshError(f"{gel.name}: no node is driven, so no gripper can move it; mark its back face.")
        self.gel = gel
        self._mounts = mounts
        driven_m = gel.rest_position_m[gel.driven_nodes]
        self._driven_m = tuple(_turned(mount.rotation, driven_m) for mount in mounts)
        self.pose = pose

    def sensor_pose(self, index: int) -> SensorPose:
        """Return the present pose of the left (0) or right (1) sensor."""
        mount, pose = self._mounts[index], self.pose
        sine, cosine = sine_cosine(pose.angle_rad)
        about_z = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        offset = mount.side * pose.half_opening_m
        centre = np.array([pose.x_m - sine * offset, pose.y_m + cosine * offset, pose.z_m])
        rows = np.ascontiguousarray(mount.rotation.T)  # one layout for all: the kernel is compiled once
        return SensorPose(rotation=_turned(about_z, rows).T, centre_m=centre)

    def driven_targets_m(self, pose: GripperPose) -> tuple[FloatArray, FloatArray]:
        """Return the world positions [m] of both gels' driven nodes when the gripper is at this pose, shapes [d, 3]."""
        sine, cosine = sine_cosine(pose.angle_rad)
        left, right = (
            _placed(driven, sine, cosine, (pose.x_m, pose.y_m, pose.z_m), mount.side * pose.half_opening_m)
            for driven, mount in zip(self._driven_m, self._mounts, strict=True)
        )
        return left, right


@allocating_kernel
def _placed(
    driven_m: FloatArray, sine: float, cosine: float, centre_m: tuple[float, float, float], offset_m: float
) -> FloatArray:
    out = np.empty_like(driven_m)
    for i in range(len(driven_m)):
        x, y = driven_m[i, 0], driven_m[i, 1] + offset_m
        out[i, 0] = cosine * x - sine * y + centre_m[0]
        out[i, 1] = sine * x + cosine * y + centre_m[1]
        out[i, 2] = driven_m[i, 2] + centre_m[2]
    return out


@allocating_kernel
def _turned(rotation: FloatArray, points: FloatArray) -> FloatArray:
    """Return rotated points, shape [n, 3], by explicit sums of products (BLAS kernels differ in their bits)."""
    out = np.empty((points.shape[0], 3))
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for k in range(3):
            out[i, k] = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z
    return out


class MotionError(VitacError):
    """A motion cannot be divided into IPC steps; the message names the value."""


def ipc_steps(amount: float, *, speed_per_s: float, time_step_s: float) -> int:
    """Return the IPC steps for a motion at a speed: the nearest whole number, ties to even, at least 1.

    The published text rounds up; the 2025 code, which the logs follow, rounds to the nearest.

    Args:
        amount: length [m] or angle [rad]; its sign does not matter.
        speed_per_s: [m/s] or [rad/s].
        time_step_s: length of an IPC step [s].
    """
    if not (speed_per_s > 0 and time_step_s > 0):
        raise MotionError(f"Speed and time step must be positive, got {speed_per_s} 1/s and {time_step_s} s.")
    return max(1, round(abs(amount) / speed_per_s / time_step_s))
