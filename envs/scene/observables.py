"""Observables of the parts that scenes are composed of; a task lists those that its policies see."""

from enum import StrEnum
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..observable import Observable
from ..tactile.gel import MARKER_COUNT, SENSING_NODES
from .measured_pose import held_pose_mm_deg

if TYPE_CHECKING:
    from .grasped_scene import GraspedScene

FloatArray = NDArray[np.float64]


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

GRIPPER_WIDTH: Observable[HasGrasp] = Observable(
    name="gripper_width",
    shape=(1,),
    unit="mm",
    meaning="Commanded width of the gripper, between both gels' highest points where nothing presses on them.",
    read=lambda scene, _: np.array([1e3 * scene.grasped.gripper_width_m]),
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
            "sheared); under arena-2 such a marker is not seen. "
            f"About 56 to 80 markers are seen, the last one is repeated up to {MARKER_COUNT}. {directions}"
        ),
        read=lambda scene, random: scene.grasped.marker_flow(random),
    )
