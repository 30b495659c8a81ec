"""Pictures of a grasped scene that are quick to make, for `render` and for videos; `vitac show` draws finer ones."""

from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

from ..scene.grasped_scene import GraspedScene
from ..scene.gripper import SENSOR_COUNT
from ..scene.perspective import Perspective, Plane
from .look import colour_picture
from .optics import HEIGHT_PX, WIDTH_PX, Intrinsics
from .pinhole import CameraPose
from .rasterizer import Body, Label, VisibleSurfaces, rasterize

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# So far away that the picture is nearly a parallel projection.
_DISTANCE_M = 2.0
# Free space around the scene, in parts of the picture: the gripper moves and the camera does not.
_MARGIN = 0.12


class StillCamera:
    """Looks at a scene from its task's perspective, with the fixed part cut open; it rides on one that moves."""

    def __init__(self, grasped: GraspedScene, perspective: Perspective) -> None:
        self._grasped = grasped
        fixed, gel = grasped.fixed_surface(), grasped.gel
        self._fixed_m, fixed_triangles = cut_open(fixed.vertices_m, fixed.triangles, perspective.cut)
        self._held_vertices = np.arange(len(grasped.held_surface.vertices_m))
        gels = [
            Body(vertex_count=len(gel.rest_position_m), triangles=gel.surface_triangles, label=label)
            for label in (Label.LEFT_GEL, Label.RIGHT_GEL)
        ]
        self._surfaces = VisibleSurfaces(
            [
                Body(vertex_count=len(self._fixed_m), triangles=fixed_triangles, label=Label.BASE),
                Body(vertex_count=len(self._held_vertices), triangles=grasped.held_surface.triangles, label=Label.PEG),
                *gels,
            ]
        )
        self._pose, self._intrinsics = _framing(self._vertices_m(), perspective)

    def picture(self) -> NDArray[np.uint8]:
        """Return how the scene looks now: red, green and blue, shape [480, 640, 3]."""
        vertices_m = self._vertices_m()
        view = rasterize(
            self._pose.transform_to_camera(vertices_m),
            self._surfaces.triangles,
            self._intrinsics,
            height_px=HEIGHT_PX,
            width_px=WIDTH_PX,
        )
        return colour_picture(view, self._surfaces, vertices_m)

    def _vertices_m(self) -> FloatArray:
        grasped = self._grasped
        shift_m = grasped.fixed_shift_m()
        held_m = grasped.held_vertices_m(self._held_vertices) - shift_m
        gels_m = [grasped.gel_nodes_m(index) - shift_m for index in range(SENSOR_COUNT)]
        return self._surfaces.vertices_m([self._fixed_m, held_m, *gels_m])


def _framing(vertices_m: FloatArray, perspective: Perspective) -> tuple[CameraPose, Intrinsics]:
    """Return a camera that looks at all points from the perspective's direction, and has them all in the picture."""
    a, e = radians(perspective.azimuth_deg), radians(perspective.elevation_deg)
    away = np.array([-cos(a) * cos(e), -sin(a) * cos(e), -sin(e)])
    right = np.array([-sin(a), cos(a), 0.0])
    rotation = np.column_stack([right, np.cross(away, right), away])
    seen_m = vertices_m @ rotation
    middle_m = 0.5 * (seen_m.min(axis=0) + seen_m.max(axis=0))
    pose = CameraPose(world_from_camera=rotation, position_m=rotation @ middle_m - _DISTANCE_M * away)
    x, y, z = pose.transform_to_camera(vertices_m).T
    reach_u, reach_v = np.abs(x / z).max() / WIDTH_PX, np.abs(y / z).max() / HEIGHT_PX
    focal_px = (0.5 - _MARGIN) / max(reach_u, reach_v)
    return pose, Intrinsics(focal_px, focal_px, 0.5 * WIDTH_PX, 0.5 * HEIGHT_PX)


def cut_open(vertices_m: FloatArray, triangles: IndexArray, plane: Plane) -> tuple[FloatArray, IndexArray]:
    """Return a surface without what is on the plane's positive side; its inside can then be seen."""
    heights_m = plane.heights_m(vertices_m)
    points: list[FloatArray] = []
    kept: list[tuple[int, int, int]] = []
    for triangle in triangles.tolist():
        outline = _clip_triangle(vertices_m[triangle], heights_m[triangle])
        kept += [(len(points), len(points) + k, len(points) + k + 1) for k in range(1, len(outline) - 1)]
        points += outline
    return np.array(points), np.array(kept)


def _clip_triangle(corners_m: FloatArray, heights_m: FloatArray) -> list[FloatArray]:
    """Return the corners of the part of a triangle on the negative side (Sutherland and Hodgman 1974)."""
    outline = []
    for k in range(3):
        here, there = heights_m[k], heights_m[(k + 1) % 3]
        if here <= 0.0:
            outline.append(corners_m[k])
        if here * there < 0.0:
            outline.append(corners_m[k] + here / (here - there) * (corners_m[(k + 1) % 3] - corners_m[k]))
    return outline
