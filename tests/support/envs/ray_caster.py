"""Casts every ray against every triangle, in the world frame: slow, and nothing in common with the rasteriser."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from vitac.envs.vision.optics import Intrinsics
from vitac.envs.vision.pinhole import CameraPose

FloatArray = NDArray[np.float64]
NO_HIT = -1


@dataclass(frozen=True, kw_only=True, eq=False)
class Hits:
    """Depth along the optical axis [m], 0 for none, and triangle, -1 for none; both of the pixels' shape."""

    depth_m: FloatArray
    triangle: NDArray[np.int64]


def cast(
    vertices_m: FloatArray,
    triangles: NDArray[np.int64],
    pose: CameraPose,
    intrinsics: Intrinsics,
    pixels: FloatArray,
    near_m: float,
) -> Hits:
    """First hit of the rays through picture points (u, v), shape [p, 2] (Moller & Trumbore 1997, from both sides)."""
    x = (pixels[:, 0] - intrinsics.centre_u_px) / intrinsics.focal_u_px
    y = (pixels[:, 1] - intrinsics.centre_v_px) / intrinsics.focal_v_px
    directions = np.column_stack([x, y, np.ones(len(x))]) @ pose.world_from_camera.T
    depth_m, triangle = np.full(len(pixels), np.inf), np.full(len(pixels), NO_HIT)
    for t, (a, b, c) in enumerate(vertices_m[triangles]):
        along_u = np.cross(directions, c - a)
        determinant = along_u @ (b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = along_u @ (pose.position_m - a) / determinant
            q = np.cross(pose.position_m - a, b - a)
            v = directions @ q / determinant
            z = float((c - a) @ q) / determinant
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (z >= near_m) & (z < depth_m)
        depth_m[hit], triangle[hit] = z[hit], t
    return Hits(depth_m=np.where(triangle == NO_HIT, 0.0, depth_m), triangle=triangle)


def pixel_centres(height_px: int, width_px: int) -> FloatArray:
    """Centres (u, v) of all pixels, row by row, shape [p, 2]."""
    rows, columns = np.mgrid[:height_px, :width_px]
    return np.column_stack([columns.ravel() + 0.5, rows.ravel() + 0.5])
