"""Observables of the camera rig; a task that has one lists those that its policies see."""

from typing import TYPE_CHECKING, Protocol

from ..observable import BackProjection, Observable
from .optics import COLOUR_INTRINSICS, HEIGHT_PX, POINTS_PER_OBJECT, WIDTH_PX

if TYPE_CHECKING:
    from .camera import Sight


class HasSight(Protocol):
    """A task's scene at which a camera rig looks."""

    def sight(self) -> "Sight":
        """Return what the rig sees now."""


RGB_PICTURE: Observable[HasSight] = Observable(
    name="rgb_picture",
    shape=(HEIGHT_PX, WIDTH_PX, 3),
    dtype="uint8",
    unit="1",
    meaning="Red, green, blue; the base is blue, the peg red, the gels light blue, the background white.",
    read=lambda scene, _: scene.sight().colours,
)
DEPTH_PICTURE: Observable[HasSight] = Observable(
    name="depth_picture",
    shape=(HEIGHT_PX, WIDTH_PX),
    unit="m",
    meaning="Distance along the colour camera's optical axis, 0 where unknown.",
    read=lambda scene, _: scene.sight().depth_m,
)
POINT_CLOUD: Observable[HasSight] = Observable(
    name="point_cloud",
    shape=(HEIGHT_PX, WIDTH_PX, 3),
    unit="m",
    meaning="Point of every pixel in the camera's frame: x right, y down, z forward; zeros where depth is unknown.",
    read=lambda scene, _: scene.sight().point_cloud_m,
    computed_from=BackProjection(depth=DEPTH_PICTURE.name, intrinsics=COLOUR_INTRINSICS),
)
OBJECT_POINT_CLOUD: Observable[HasSight] = Observable(
    name="object_point_cloud",
    shape=(2, POINTS_PER_OBJECT, 3),
    unit="m",
    meaning="Random points of `point_cloud` on the peg and on the base; zeros for one that is not seen.",
    read=lambda scene, _: scene.sight().objects.points_m,
)
SEGMENTATION: Observable[HasSight] = Observable(
    name="segmentation",
    shape=(HEIGHT_PX, WIDTH_PX),
    dtype="uint8",
    unit="1",
    meaning="0 nothing, 1 base, 2 peg, 3 left gel, 4 right gel.",
    read=lambda scene, _: scene.sight().segmentation,
    privileged=True,
)
"""For training: no task lists it, it is given to an environment's `observables`."""
