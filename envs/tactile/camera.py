"""The sensor's inner camera: its pose on the gel and its pinhole projection."""

from math import radians
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import allocating_kernel, kernel
from ..deterministic_math import sine_cosine


class CameraIntrinsics(NamedTuple):
    """A pinhole without distortion, for a picture of 320 x 240 pixels; the defaults are the challenge's.

    Attributes:
        focal_u_px: focal length along the picture's rows.
        focal_v_px: along its columns.
        centre_u_px: where the camera's axis meets the picture.
        centre_v_px: the same, downwards.
    """

    focal_u_px: float = 340.0
    focal_v_px: float = 325.0
    centre_u_px: float = 160.0
    centre_v_px: float = 125.0


CHALLENGE_CAMERA = CameraIntrinsics()
_MIDDLE_PX = (160.0, 120.0)
_CORNER_PX = 200.0


class CameraMount(NamedTuple):
    """How a camera is mounted, and what its lens does.

    Attributes:
        shift_u_px: of the whole picture along u.
        shift_v_px: of the whole picture along v.
        turn_deg: of the picture about its middle.
        distortion: relative distance from the middle that the lens adds at a corner of the picture.
    """

    shift_u_px: float = 0.0
    shift_v_px: float = 0.0
    turn_deg: float = 0.0
    distortion: float = 0.0

    def see(self, positions_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where the camera sees what an ideal one sees at some positions, shape [..., 2] [pixel]."""
        u, v = positions_px[..., 0] - _MIDDLE_PX[0], positions_px[..., 1] - _MIDDLE_PX[1]
        factor = 1.0 + self.distortion * (u * u + v * v) / _CORNER_PX**2
        u, v = u * factor, v * factor
        sine, cosine = sine_cosine(radians(self.turn_deg))
        seen_u = cosine * u - sine * v + _MIDDLE_PX[0] + self.shift_u_px
        seen_v = sine * u + cosine * v + _MIDDLE_PX[1] + self.shift_v_px
        return np.stack([seen_u, seen_v], axis=-1)


CHALLENGE_MOUNT = CameraMount()


@allocating_kernel
def camera_frame(
    positions_m: NDArray[np.float64],
    rotation: NDArray[np.float64],
    centre_m: NDArray[np.float64],
    distance_m: float,
) -> NDArray[np.float64]:
    """Return world positions in a sensor's camera frame (OpenCV axes: x = -x_gel, y = -y_gel, z = z_gel + distance).

    The camera sits on the gel's axis and looks out of the sensing face.

    Args:
        positions_m: world positions [m], shape [n, 3].
        rotation: world from gel, shape [3, 3].
        centre_m: origin of the gel's frame in the world [m], shape [3].
        distance_m: of the camera behind that origin [m]; `thickness.eye_distance_m`.
    """
    out = np.empty_like(positions_m)
    for i in range(positions_m.shape[0]):
        x = positions_m[i, 0] - centre_m[0]
        y = positions_m[i, 1] - centre_m[1]
        z = positions_m[i, 2] - centre_m[2]
        out[i, 0] = -(rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z)
        out[i, 1] = -(rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z)
        out[i, 2] = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z + distance_m
    return out


@allocating_kernel
def project(points_m: NDArray[np.float64], camera: CameraIntrinsics) -> NDArray[np.float64]:
    """Return the pixel coordinates (u, v), shape [n, 2], of camera-frame points [m], shape [n, 3]."""
    out = np.empty((points_m.shape[0], 2))
    for i in range(points_m.shape[0]):
        out[i, 0] = camera.focal_u_px * points_m[i, 0] / points_m[i, 2] + camera.centre_u_px
        out[i, 1] = camera.focal_v_px * points_m[i, 1] / points_m[i, 2] + camera.centre_v_px
    return out


@kernel
def weighted_distance_m(
    first_m: NDArray[np.float64], second_m: NDArray[np.float64], weights: NDArray[np.float64]
) -> float:
    """Return the weighted sum of the Euclidean distances [m] between corresponding points, shapes [n, 3] and [n]."""
    total: float = 0.0
    for i in range(first_m.shape[0]):
        x = first_m[i, 0] - second_m[i, 0]
        y = first_m[i, 1] - second_m[i, 1]
        z = first_m[i, 2] - second_m[i, 2]
        total += weights[i] * np.sqrt(x * x + y * y + z * z)
    return total


@kernel
def mean_distance_m(first_m: NDArray[np.float64], second_m: NDArray[np.float64]) -> float:
    """Return the mean Euclidean distance [m] between corresponding points, both of shape [n, 3]."""
    total: float = 0.0
    for i in range(first_m.shape[0]):
        x = first_m[i, 0] - second_m[i, 0]
        y = first_m[i, 1] - second_m[i, 1]
        z = first_m[i, 2] - second_m[i, 2]
        total += np.sqrt(x * x + y * y + z * z)
    mean: float = total / first_m.shape[0]
    return mean


FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Each triangle is cut into the square of this many equal ones; a place is the centre of one.
_PARTS = 4


class FacePlaces(NamedTuple):
    """Places on triangles.

    Attributes:
        corners: of the triangle of each place, shape [q, 3].
        weights: barycentric, shape [q, 3].
        areas_m2: of the part of the faces that each place stands for [m2], shape [q].
    """

    corners: IndexArray
    weights: FloatArray
    areas_m2: FloatArray

    def select(self, chosen: NDArray[np.bool_]) -> "FacePlaces":
        """Return some of the places."""
        return FacePlaces(self.corners[chosen], self.weights[chosen], self.areas_m2[chosen])


def places_on_faces(positions_m: FloatArray, triangles: IndexArray) -> FacePlaces:
    """Return 16 places on each triangle.

    Args:
        positions_m: of nodes [m], shape [n, 3].
        triangles: numbers of nodes, shape [f, 3].
    """
    inner = np.array(
        [
            ((3 * i + 1 + up) / (3 * _PARTS), (3 * j + 1 + up) / (3 * _PARTS))
            for up in (0, 1)
            for i in range(_PARTS)
            for j in range(_PARTS - i - up)
        ]
    )
    weights = np.column_stack([1.0 - inner.sum(axis=1), inner])
    corners_m = positions_m[triangles]
    normals = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    areas_m2 = 0.5 * np.sqrt((normals * normals).sum(axis=1)) / len(weights)
    return FacePlaces(
        corners=np.repeat(triangles, len(weights), axis=0),
        weights=np.tile(weights, (len(triangles), 1)),
        areas_m2=np.repeat(areas_m2, len(weights)),
    )
