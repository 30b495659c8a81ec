"""Scenes to look at: random bodies, and the fusion task at its official starts."""

from dataclasses import dataclass
from functools import cache
from math import radians

import numpy as np
from numpy.typing import NDArray
from vitac.envs.deterministic_math import sine_cosine
from vitac.envs.geometry.bases import RIM_MM, base_surface, hexagon_peg_surface
from vitac.envs.geometry.pegs import PegShape, peg_surface
from vitac.envs.tactile.gel import gelsight_mini_mesh
from vitac.envs.vision.optics import COLOUR_INTRINSICS, HEIGHT_PX, WIDTH_PX, Intrinsics
from vitac.envs.vision.pinhole import CameraPose, colour_camera_pose
from vitac.envs.vision.rasterizer import Body, Label, RenderedView, VisibleSurfaces, rasterize

FloatArray = NDArray[np.float64]

# x, y [mm], theta [deg], z [mm], hexagon (1) or cuboid (0): the evaluated starts.
STARTS = (
    (2.3, -4.1, -3.2, 8.8, 1),
    (-3.0, 0.5, -6.3, 7.9, 1),
    (3.2, 0.5, 4.2, 3.4, 1),
    (-1.3, 2.1, 9.1, 7.9, 0),
    (-1.9, 0.3, -1.9, 5.4, 1),
    (-1.5, 1.0, -9.0, 4.9, 1),
    (1.8, -2.4, 5.0, 8.9, 1),
    (1.1, -2.7, 1.9, 3.6, 0),
    (-4.8, -4.0, 5.8, 6.3, 0),
    (-3.2, 1.1, 9.0, 8.8, 1),
    (1.2, 0.2, -3.2, 6.8, 0),
    (4.2, -4.9, -5.6, 4.8, 1),
    (4.8, 3.6, 4.9, 8.4, 0),
    (-4.2, -2.7, -3.3, 5.8, 0),
    (-4.0, 2.2, 3.7, 5.3, 1),
    (1.6, 0.3, -6.5, 5.7, 1),
    (3.6, -3.7, 0.2, 6.7, 1),
    (-3.0, 3.8, -3.8, 4.2, 0),
    (1.9, -2.4, 1.7, 3.1, 0),
    (1.4, -2.5, -6.1, 5.4, 1),
    (1.7, 1.5, 9.1, 8.2, 1),
    (-1.2, 0.1, 8.8, 8.6, 0),
    (-3.5, 3.5, 1.4, 4.5, 1),
    (4.9, -4.2, -3.9, 5.7, 1),
    (-4.2, 4.7, -4.8, 5.7, 0),
    (3.2, -2.3, 7.9, 5.8, 0),
    (-2.8, 0.8, 0.1, 7.2, 1),
    (0.8, -3.6, 0.5, 3.9, 0),
    (-3.6, 0.0, -0.9, 5.3, 0),
    (3.5, 4.7, -7.3, 3.4, 1),
    (-3.4, -1.4, 1.5, 4.5, 0),
    (-0.7, 4.6, 7.7, 7.9, 1),
    (4.9, -1.6, -3.2, 8.6, 1),
    (3.2, -0.1, 1.2, 5.1, 0),
    (3.3, 4.6, -5.5, 3.6, 1),
    (2.9, 4.1, 3.8, 4.2, 0),
    (0.1, 5.0, -9.2, 3.2, 0),
    (4.1, -3.9, 6.3, 7.9, 1),
    (-1.2, -3.8, 7.8, 7.8, 1),
    (0.7, -4.0, -3.2, 7.0, 0),
    (-1.2, -4.5, -2.7, 6.3, 1),
    (-4.5, 2.1, -2.5, 5.4, 1),
    (0.0, 2.3, 9.1, 4.0, 0),
    (0.2, 1.7, -6.4, 4.5, 1),
    (-2.7, -3.4, 7.5, 4.9, 1),
    (3.6, 0.3, 8.8, 8.6, 1),
    (-2.9, -0.6, 2.6, 6.5, 0),
    (-3.4, -1.9, 4.1, 6.6, 1),
    (2.3, 2.9, -8.5, 6.6, 1),
    (-3.9, 1.8, 9.9, 8.4, 1),
)
_BOX = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
_BOX_TRIANGLES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5)),
        *((0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6)),
        *((0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ]
)


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenScene:
    """Surfaces, their vertices in the world [m], and the camera that looks at them."""

    surfaces: VisibleSurfaces
    vertices_m: FloatArray
    pose: CameraPose

    def view(
        self, intrinsics: Intrinsics = COLOUR_INTRINSICS, *, height_px: int = HEIGHT_PX, width_px: int = WIDTH_PX
    ) -> RenderedView:
        """What the camera sees."""
        vertices_m = self.pose.transform_to_camera(self.vertices_m)
        return rasterize(vertices_m, self.surfaces.triangles, intrinsics, height_px=height_px, width_px=width_px)


def random_scene(random: np.random.Generator, bodies: int) -> SeenScene:
    """Boxes of all sizes and turns in front of a camera, some across its near plane, some beside its picture."""
    camera = CameraPose(world_from_camera=random_rotation(random), position_m=random.uniform(-0.5, 0.5, 3))
    positions_m = []
    for _ in range(bodies):
        centre = np.array([*random.uniform(-0.4, 0.4, 2), random.uniform(0.05, 0.9)])
        shape = _BOX * random.uniform(0.005, 0.1, 3) @ random_rotation(random).T + centre
        positions_m.append(shape @ camera.world_from_camera.T + camera.position_m)
    labels = list(Label)[1:]
    surfaces = VisibleSurfaces(
        [Body(vertex_count=8, triangles=_BOX_TRIANGLES, label=labels[i % len(labels)]) for i in range(bodies)]
    )
    return SeenScene(surfaces=surfaces, vertices_m=surfaces.vertices_m(positions_m), pose=camera)


def random_rotation(random: np.random.Generator) -> FloatArray:
    """Right-handed rotation, shape [3, 3]."""
    q, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return np.ascontiguousarray(q * np.sign(np.linalg.det(q)))


@cache
def fusion_scene(start: tuple[float, float, float, float, int]) -> SeenScene:
    """The fusion task at a start, with undeformed gels that touch the peg; of the same bits everywhere."""
    x_mm, y_mm, theta_deg, z_mm, hexagon = start
    base, gel = base_surface(), gelsight_mini_mesh()
    peg = hexagon_peg_surface() if hexagon else peg_surface(PegShape.CUBOID)
    sine, cosine = sine_cosine(radians(theta_deg))
    origin_m = np.array([x_mm, 22.625 + y_mm, RIM_MM + z_mm + 1.0]) * 1e-3
    surfaces = VisibleSurfaces(
        [
            Body(vertex_count=len(base.vertices_m), triangles=base.triangles, label=Label.BASE),
            Body(vertex_count=len(peg.vertices_m), triangles=peg.triangles, label=Label.PEG),
            *(
                Body(vertex_count=len(gel.rest_position_m), triangles=gel.surface_triangles, label=label)
                for label in (Label.LEFT_GEL, Label.RIGHT_GEL)
            ),
        ]
    )
    # Left: the gel's x points down, its y along +x, its z along -y; right: down, -x, +y.
    x, y, z = gel.rest_position_m.T
    left_m = np.column_stack([y, 0.017 - z, 0.042 - x])
    right_m = np.column_stack([-y, z - 0.017, 0.042 - x])
    moving_m = []
    for part_m in (peg.vertices_m, left_m, right_m):
        x, y, z = part_m.T
        moving_m.append(np.column_stack([cosine * x - sine * y, sine * x + cosine * y, z]) + origin_m)
    return SeenScene(
        surfaces=surfaces,
        vertices_m=surfaces.vertices_m([base.vertices_m, *moving_m]),
        pose=colour_camera_pose(float(origin_m[1]), float(origin_m[2]) - 1e-3),
    )
