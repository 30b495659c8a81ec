"""What can be observed of any grasped scene, where the held part really is among it; light to import."""

from enum import StrEnum
from math import atan2, hypot
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..observable import Observable
from ..tactile.gel import MARKER_COUNT, SENSING_NODES

if TYPE_CHECKING:
    from .grasped_scene import GraspedScene

FloatArray = NDArray[np.float64]


def held_pose_mm_deg(grasped: "GraspedScene") -> FloatArray:
    """Return where the held part is: its own origin (x, y, z) and its roll, pitch and yaw [mm, deg], shape [6].

    The turns are made about the world's axes: about x, then y, then z.
    """
    rest_m = grasped.held.mesh.vertices_m
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


class HasGrasp(Protocol):
    """A task's scene in which a gripper with two tactile sensors holds a part."""

    grasped: "GraspedScene"


class HasShape(Protocol):
    """A task's scene that plays one of several shapes."""

    @property
    def shape(self) -> StrEnum:
        """Which one."""


MEASURED_POSE: Observable[HasGrasp] = Observable(
    name="measured_pose",
    shape=(6,),
    unit="mm, mm, mm, degree, degree, degree",
    meaning=(
        "Where the held part really is, which differs from what is commanded: x, y and z of its own origin in the "
        "world, and its roll, pitch and yaw."
    ),
    read=lambda scene, _: held_pose_mm_deg(scene.grasped),
    privileged=True,
)

CONTACT_FORCES: Observable[HasGrasp] = Observable(
    name="contact_forces",
    shape=(3, 3),
    unit="N",
    meaning=(
        "[held part, left gel, right gel][x, y, z] forces of contacts in the world at the end of the env step: on the "
        "held part of all that does not hold it, on a gel of all that it touches."
    ),
    read=lambda scene, _: scene.grasped.contact_forces_n(),
    privileged=True,
)

SURFACE_POINTS: Observable[HasGrasp] = Observable(
    name="surface_pts",
    shape=(2, 2, SENSING_NODES, 3),
    unit="m",
    meaning=(
        "[sensor left, right][reference, current][node][x, y, z] of the sensing faces in the sensors' camera frames, "
        "without noise."
    ),
    read=lambda scene, _: scene.grasped.surface_points_m(),
    privileged=True,
    node_axis=2,
)


def played_shape(shapes: str) -> Observable[HasShape]:
    """Return the observable of the shape that is played.

    Args:
        shapes: their names in the order of the numbers.
    """
    return Observable(
        name="shape",
        shape=(1,),
        unit="1",
        meaning=f"Number of the shape that is played, from 0: {shapes}.",
        read=lambda scene, _: np.array([list(type(scene.shape)).index(scene.shape)]),
        privileged=True,
    )


def marker_flow(directions: str) -> Observable[HasGrasp]:
    """Return the observable of both sensors' markers.

    Args:
        directions: which way u and v point in this task, as sentences.
    """
    return Observable(
        name="marker_flow",
        shape=(2, 2, MARKER_COUNT, 2),
        unit="pixel",
        meaning=(
            "[sensor left, right][reference, current][marker][u, v] in a 320 x 240 image. The reference is taken after "
            "the grasp, and decides which markers are seen: those inside the image. A current position is given as it "
            "is projected, as the challenge does, also where it has left the image (up to 30 px outside while a gel is "
            f"sheared). About 56 to 80 markers are seen, the last one is repeated up to {MARKER_COUNT}. {directions}"
        ),
        read=lambda scene, random: scene.grasped.marker_flow(random),
    )
