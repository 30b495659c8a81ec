"""Which triangle every pixel of a camera shows, and at what depth. Exact: each covered pixel's ray meets the triangle.

No state is kept between pictures and no threads are used; the same vertices give the same bits on every machine.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel, large_kernel
from ..fem.algebra.vec3 import Vec3, cross, dot, load, subtract
from .pinhole import Intrinsics

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# What lies nearer to the camera's plane is not seen (challenge-facts 15).
NEAR_M = 0.1
NO_TRIANGLE = -1
# A plane this close to the optical centre is seen edge-on: its two sides fall on one line of the picture.
_EDGE_ON_M = 1e-9
# Corners are projected with rounding, so the pixels between them are looked for one pixel further out.
_MARGIN_PX = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """What a camera sees.

    Attributes:
        depth_m: distance along the optical axis [m], 0 where nothing is seen, shape [height, width].
        triangle: index of the triangle that is seen, -1 for none, shape [height, width].
    """

    depth_m: FloatArray
    triangle: NDArray[np.int32]

    @cached_property
    def box(self) -> tuple[slice, slice]:
        """Rows and columns of the smallest rectangle that holds every pixel that shows something; may be empty."""
        seen = self.triangle >= 0
        rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if len(rows) == 0:
            return slice(0, 0), slice(0, 0)
        return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def rasterize(
    vertices_m: FloatArray, triangles: IndexArray, intrinsics: Intrinsics, *, height_px: int, width_px: int
) -> View:
    """Find the nearest triangle along every pixel's ray, from either side, at `NEAR_M` or more; the first of equals.

    Args:
        vertices_m: vertices in the camera's frame [m], shape [n, 3].
        triangles: vertex indices, shape [t, 3].
        intrinsics: of the camera.
        height_px: rows of the picture.
        width_px: columns of the picture.
    """
    depth_m = np.zeros((height_px, width_px))
    triangle = np.full((height_px, width_px), NO_TRIANGLE, dtype=np.int32)
    _draw_triangles(vertices_m, triangles, intrinsics, depth_m, triangle)
    return View(depth_m=depth_m, triangle=triangle)


@large_kernel
def _draw_triangles(
    vertices_m: FloatArray,
    triangles: IndexArray,
    intrinsics: Intrinsics,
    depth_m: FloatArray,
    triangle_at: NDArray[np.int32],
) -> None:
    """Draw all triangles into the buffers.

    A point of the ray d = (x, y, 1) is z d. It lies in the triangle abc where d.(b x c), d.(c x a) and d.(a x b) have
    the sign of a.(b x c), and in its plane where z = n.a / n.d, n = (b - a) x (c - a). The products of an edge that two
    triangles share differ in nothing but their sign, so no ray slips through between them.
    """
    for t in range(triangles.shape[0]):
        a, b, c = (
            load(vertices_m, triangles[t, 0]),
            load(vertices_m, triangles[t, 1]),
            load(vertices_m, triangles[t, 2]),
        )
        normal = cross(subtract(b, a), subtract(c, a))
        distance = dot(normal, a)
        if distance * distance <= _EDGE_ON_M * _EDGE_ON_M * dot(normal, normal):
            continue
        if max(a[2], b[2], c[2]) < NEAR_M:
            continue
        if distance < 0.0:
            b, c = c, b
            normal = (-normal[0], -normal[1], -normal[2])
            distance = -distance
        over_a, over_b, over_c = cross(b, c), cross(c, a), cross(a, b)
        first_row, last_row, first_column, last_column = _pixel_range(a, b, c, intrinsics, depth_m.shape)
        for j in range(first_row, last_row + 1):
            y = (j + 0.5 - intrinsics.centre_v_px) / intrinsics.focal_v_px
            row_a = over_a[1] * y + over_a[2]
            row_b = over_b[1] * y + over_b[2]
            row_c = over_c[1] * y + over_c[2]
            row_n = normal[1] * y + normal[2]
            for i in range(first_column, last_column + 1):
                x = (i + 0.5 - intrinsics.centre_u_px) / intrinsics.focal_u_px
                if over_a[0] * x + row_a < 0.0 or over_b[0] * x + row_b < 0.0 or over_c[0] * x + row_c < 0.0:
                    continue
                z = distance / (normal[0] * x + row_n)
                if z >= NEAR_M and not 0.0 < depth_m[j, i] <= z:
                    depth_m[j, i] = z
                    triangle_at[j, i] = t


@kernel
def _pixel_range(
    a: Vec3, b: Vec3, c: Vec3, intrinsics: Intrinsics, shape: tuple[int, int]
) -> tuple[int, int, int, int]:
    """First and last row and column that a triangle can cover: all, where it reaches nearer than `NEAR_M`."""
    if min(a[2], b[2], c[2]) < NEAR_M:
        return 0, shape[0] - 1, 0, shape[1] - 1
    u = (a[0] / a[2], b[0] / b[2], c[0] / c[2])
    v = (a[1] / a[2], b[1] / b[2], c[1] / c[2])
    first_row = intrinsics.focal_v_px * min(v) + intrinsics.centre_v_px - 0.5 - _MARGIN_PX
    last_row = intrinsics.focal_v_px * max(v) + intrinsics.centre_v_px - 0.5 + _MARGIN_PX
    first_column = intrinsics.focal_u_px * min(u) + intrinsics.centre_u_px - 0.5 - _MARGIN_PX
    last_column = intrinsics.focal_u_px * max(u) + intrinsics.centre_u_px - 0.5 + _MARGIN_PX
    return (
        int(min(max(first_row, 0.0), shape[0])),
        int(max(min(last_row, shape[0] - 1.0), -1.0)),
        int(min(max(first_column, 0.0), shape[1])),
        int(max(min(last_column, shape[1] - 1.0), -1.0)),
    )
