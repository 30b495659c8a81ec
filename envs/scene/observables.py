"""Observables of the parts that scenes are composed of; a task lists those that its policies see."""

from typing import TYPE_CHECKING, Protocol

from ..observable import Observable
from ..tactile.sizes import MARKER_COUNT

if TYPE_CHECKING:
    from .grasped_scene import GraspedScene


class HasGrasp(Protocol):
    """A task's scene in which a gripper with two tactile sensors holds a part."""

    grasped: "GraspedScene"


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
            "the grasp. About 56 to 80 markers are seen, the last one is repeated up to "
            f"{MARKER_COUNT}. {directions}"
        ),
        read=lambda scene, random: scene.grasped.marker_flow(random),
    )
