"""Observables of the camera rig; a task that has one lists those that its policies see."""

from typing import TYPE_CHECKING, Protocol

from ..observable import BackProjection, Observable
from ..scene.observables import HasGrasp
from .optics import COLOUR_INTRINSICS, HEIGHT_PX, POINTS_PER_OBJECT, TACTILE_HEIGHT_PX, TACTILE_WIDTH_PX, WIDTH_PX

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

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
    meaning="Red, green, blue; the base is blue, the peg red, the gels light blue; all else white, or table and wall.",
    read=lambda scene, _: scene.sight().colours,
    picture=True,
)
DEPTH_PICTURE: Observable[HasSight] = Observable(
    name="depth_picture",
    shape=(HEIGHT_PX, WIDTH_PX),
    unit="m",
    meaning="Distance along the colour camera's optical axis, 0 where unknown.",
    read=lambda scene, _: scene.sight().depth_m,
    picture=True,
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
    meaning="0 nothing, 1 base, 2 peg, 3 left gel, 4 right gel, 5 and 6 clutter in the base's and the peg's colour, "
    "7 table, 8 wall.",
    read=lambda scene, _: scene.sight().segmentation,
    privileged=True,
)
"""For training: no task lists it, it is given to an environment's `observables`."""


def _tactile_pictures(scene: HasGrasp, random: "np.random.Generator") -> "NDArray[np.uint8]":
    from .tactile_picture import draw_tactile_pictures

    return draw_tactile_pictures(scene.grasped, random)


RGB_IMAGES: Observable[HasGrasp] = Observable(
    name="rgb_images",
    shape=(2, TACTILE_HEIGHT_PX, TACTILE_WIDTH_PX, 3),
    dtype="uint8",
    unit="1",
    meaning=(
        "[sensor left, right] blue, green, red: the gel from inside under three lights, with the markers of "
        "`marker_flow` as dots, and noise."
    ),
    read=_tactile_pictures,
)
"""Optional in every task with two tactile sensors: a track file lists it, or an environment's argument.

A record holds no hash of it, since its dots are drawn from the episode's generator at every observation. In the 2025
code they are another grid than that of `marker_flow`; here they are the same.
"""
