"""The rig as a sensor of a task: one look gives colour, depth and clouds that belong together."""

from collections.abc import Sequence
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .pictures import colour_picture, depth_picture, segmentation_picture
from .pinhole import CameraPose
from .point_cloud import object_clouds, point_cloud
from .rasterizer import rasterize
from .rig import COLOUR_INTRINSICS
from .sizes import HEIGHT_PX, WIDTH_PX
from .stereo.camera import stereo_depth_m
from .surfaces import Body, FloatArray, VisibleSurfaces


class DepthMode(StrEnum):
    """Where a depth picture comes from."""

    GT = "gt"  # exact, from the geometry
    STEREO = "stereo"  # as the active stereo camera measures it


class Sight:
    """What the rig saw at one moment.

    Attributes:
        colours: red, green and blue, shape [480, 640, 3].
        depth_m: along the optical axis [m], 0 where unknown, shape [480, 640].
        objects: points on peg and base, and whether they were seen.
    """

    def __init__(
        self,
        surfaces: VisibleSurfaces,
        vertices_m: FloatArray,
        *,
        pose: CameraPose,
        depth_mode: DepthMode,
        random: np.random.Generator,
    ) -> None:
        in_camera_m = pose.in_camera(vertices_m)
        self._surfaces = surfaces
        self._view = rasterize(
            in_camera_m, surfaces.triangles, COLOUR_INTRINSICS, height_px=HEIGHT_PX, width_px=WIDTH_PX
        )
        self.colours = colour_picture(self._view, surfaces, vertices_m)
        if depth_mode is DepthMode.GT:
            self.depth_m = depth_picture(self._view)
        else:
            self.depth_m = stereo_depth_m(surfaces, vertices_m, pose=pose, colour_view=self._view, random=random)
        self.objects = object_clouds(self.colours, self.depth_m, COLOUR_INTRINSICS, random)

    @cached_property
    def segmentation(self) -> NDArray[np.uint8]:
        """`Label` of every pixel, shape [480, 640]."""
        return segmentation_picture(self._view, self._surfaces)

    @cached_property
    def point_cloud_m(self) -> NDArray[np.float32]:
        """Point of every pixel in the camera's frame [m], zeros where its depth is unknown, shape [480, 640, 3]."""
        return point_cloud(self.depth_m, COLOUR_INTRINSICS)


class RigCamera:
    """Looks at bodies from poses that the caller gives.

    Args:
        bodies: what can be seen, made once.
        depth_mode: where depth comes from.
    """

    def __init__(self, bodies: Sequence[Body], depth_mode: DepthMode) -> None:
        self._surfaces = VisibleSurfaces(bodies)
        self._depth_mode = depth_mode

    def look(self, positions_m: Sequence[FloatArray], pose: CameraPose, random: np.random.Generator) -> Sight:
        """Take all pictures of the bodies at these vertex positions in the world [m], one array of [n, 3] each."""
        vertices_m = self._surfaces.vertices_m(positions_m)
        return Sight(self._surfaces, vertices_m, pose=pose, depth_mode=self._depth_mode, random=random)
