"""The rig as a sensor of a task: one look gives colour, depth and clouds that belong together."""

from collections.abc import Sequence
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .look import CHALLENGE_LOOK, Look, colour_picture, depth_picture, segmentation_picture, unit_normals
from .optics import COLOUR_INTRINSICS, HEIGHT_PX, WIDTH_PX, point_cloud
from .pinhole import CameraPose, ObjectClouds, draw_points, object_clouds
from .rasterizer import Body, FloatArray, Label, RenderedView, VisibleSurfaces, rasterize
from .stereo.camera import InfraredPair, depth_of_pair, draw_noise_keys, infrared_pair


class DepthMode(StrEnum):
    """Where a depth picture comes from."""

    GT = "gt"  # exact, from the geometry
    STEREO = "stereo"  # as the active stereo camera measures it


class Sight:
    """What the rig saw at one moment; each picture is made when it is first asked for.

    The numbers for the noise are drawn at once, so that a picture does not depend on which others are asked for.

    Attributes:
        pose: of the colour camera.
    """

    def __init__(
        self,
        surfaces: VisibleSurfaces,
        vertices_m: FloatArray,
        *,
        pose: CameraPose,
        depth_mode: DepthMode,
        look: Look = CHALLENGE_LOOK,
        random: np.random.Generator,
    ) -> None:
        self._surfaces, self._vertices_m, self.pose, self._depth_mode = surfaces, vertices_m, pose, depth_mode
        self._look = look
        self._noise_keys = draw_noise_keys(random)
        self._cloud_draws = draw_points(random)

    @cached_property
    def _view(self) -> RenderedView:
        in_camera_m = self.pose.transform_to_camera(self._vertices_m)
        return rasterize(
            in_camera_m, self._surfaces.triangles, COLOUR_INTRINSICS, height_px=HEIGHT_PX, width_px=WIDTH_PX
        )

    @cached_property
    def colours(self) -> NDArray[np.uint8]:
        """Red, green and blue, shape [480, 640, 3]."""
        return colour_picture(self._view, self._surfaces, self._vertices_m, self._look)

    @cached_property
    def depth_m(self) -> NDArray[np.float32]:
        """Distance along the optical axis [m], 0 where unknown, shape [480, 640]."""
        if self._depth_mode is DepthMode.GT:
            return depth_picture(self._view)
        return depth_of_pair(self.infrared, self._view)

    @cached_property
    def infrared(self) -> InfraredPair:
        """Pictures that the stereo camera measures depth with, also where depth is exact."""
        return infrared_pair(
            self._surfaces,
            self._vertices_m,
            pose=self.pose,
            colour_view=self._view,
            noise_keys=self._noise_keys,
        )

    @cached_property
    def objects(self) -> ObjectClouds:
        """Points on peg and base, and whether they were seen."""
        return object_clouds(self.colours, self.depth_m, COLOUR_INTRINSICS, self._cloud_draws)

    @cached_property
    def segmentation(self) -> NDArray[np.uint8]:
        """`Label` of every pixel, shape [480, 640]."""
        return segmentation_picture(self._view, self._surfaces)

    @property
    def labels(self) -> frozenset[int]:
        """Classes of the bodies that there are, whether the picture shows them or not."""
        return frozenset(self._surfaces.labels.tolist())

    def list_triangles(self, label: Label) -> tuple[FloatArray, FloatArray]:
        """Return corners [m], shape [t, 3, 3], and outward unit normals, shape [t, 3], of a class in the world."""
        triangles = self._surfaces.triangles[self._surfaces.labels == label]
        return self._vertices_m[triangles], unit_normals(self._vertices_m, triangles)

    @cached_property
    def point_cloud_m(self) -> NDArray[np.float32]:
        """Point of every pixel in the camera's frame [m], zeros where its depth is unknown, shape [480, 640, 3]."""
        return point_cloud(self.depth_m, COLOUR_INTRINSICS)


class RigCamera:
    """Looks at bodies from poses that the caller gives.

    Args:
        bodies: what can be seen, made once.
        depth_mode: where depth comes from.
        look: how pictures differ from the challenge's.
    """

    def __init__(self, bodies: Sequence[Body], depth_mode: DepthMode, look: Look = CHALLENGE_LOOK) -> None:
        self._surfaces = VisibleSurfaces(bodies)
        self._depth_mode, self._picture_look = depth_mode, look

    def look(self, positions_m: Sequence[FloatArray], pose: CameraPose, random: np.random.Generator) -> Sight:
        """Look at the bodies at these vertex positions in the world [m], one array of [n, 3] each.

        Args:
            positions_m: of every body.
            pose: of the colour camera.
            random: the noise of this look is drawn from it; as many numbers whatever is seen.
        """
        vertices_m = self._surfaces.vertices_m(positions_m)
        return Sight(
            self._surfaces,
            vertices_m,
            pose=pose,
            depth_mode=self._depth_mode,
            look=self._picture_look,
            random=random,
        )
