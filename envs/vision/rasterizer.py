"""Draws triangles into a picture by depth, and which surfaces there are."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..compilation import kernel, large_kernel
from ..fem.algebra import Vec3, cross, dot, load, subtract
from .optics import Intrinsics

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# What lies nearer to the camera's plane is not seen.
NEAR_M = 0.1
NO_TRIANGLE = -1
# A plane this close to the optical centre is seen edge-on: its two sides fall on one line of the picture.
_EDGE_ON_M = 1e-9
# Corners are projected with rounding, so the pixels between them are looked for one pixel further out.
_MARGIN_PX = 1


class _Screen(NamedTuple):
    """What is drawn on: a camera's intrinsics, the smallest depth it sees [m], and the arrays of a `RenderedView`."""

    intrinsics: Intrinsics
    near_m: float
    depth_m: FloatArray
    triangle: NDArray[np.int32]


@dataclass(frozen=True, kw_only=True, eq=False)
class RenderedView:
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
    vertices_m: FloatArray,
    triangles: IndexArray,
    intrinsics: Intrinsics,
    *,
    height_px: int,
    width_px: int,
    near_m: float = NEAR_M,
) -> RenderedView:
    """Find the nearest triangle along every pixel's ray, from either side; the first of equals.

    Args:
        vertices_m: vertices in the camera's frame [m], shape [n, 3].
        triangles: vertex indices, shape [t, 3].
        intrinsics: of the camera.
        height_px: rows of the picture.
        width_px: columns of the picture.
        near_m: smallest depth that is seen [m].
    """
    depth_m = np.zeros((height_px, width_px))
    triangle = np.full((height_px, width_px), NO_TRIANGLE, dtype=np.int32)
    _draw_all(vertices_m, triangles, _Screen(intrinsics, near_m, depth_m, triangle))
    return RenderedView(depth_m=depth_m, triangle=triangle)


@large_kernel
def _draw_all(vertices_m: FloatArray, triangles: IndexArray, screen: _Screen) -> None:
    for t in range(triangles.shape[0]):
        a = load(vertices_m, triangles[t, 0])
        b = load(vertices_m, triangles[t, 1])
        c = load(vertices_m, triangles[t, 2])
        if max(a[2], b[2], c[2]) < screen.near_m:
            continue
        # Seen from the front the corners run clockwise around a ray; those of a back face are exchanged.
        if dot(cross(b, c), a) < 0.0:
            b, c = c, b
        _draw(t, (a, b, c), screen)


@kernel
def _draw(t: int, corners: tuple[Vec3, Vec3, Vec3], screen: _Screen) -> None:
    """Draw a triangle abc with a.(b x c) > 0 where nothing nearer is drawn.

    A point of the ray d = (x, y, 1) is z d. It lies in the triangle where d.(b x c), d.(c x a) and d.(a x b) are not
    negative, and in its plane where z = n.a / n.d, n = (b - a) x (c - a). The products of an edge that two triangles
    share differ in nothing but their sign, so no ray slips through between them.
    """
    a, b, c = corners
    over_a, over_b, over_c = cross(b, c), cross(c, a), cross(a, b)
    normal = cross(subtract(b, a), subtract(c, a))
    distance = dot(normal, a)
    if distance * distance <= _EDGE_ON_M * _EDGE_ON_M * dot(normal, normal):
        return
    optics = screen.intrinsics
    first_row, last_row, first_column, last_column = _pixel_range(corners, screen)
    for j in range(first_row, last_row + 1):
        y = (j + 0.5 - optics.centre_v_px) / optics.focal_v_px
        row_a, row_b = over_a[1] * y + over_a[2], over_b[1] * y + over_b[2]
        row_c, row_n = over_c[1] * y + over_c[2], normal[1] * y + normal[2]
        for i in range(first_column, last_column + 1):
            x = (i + 0.5 - optics.centre_u_px) / optics.focal_u_px
            if over_a[0] * x + row_a < 0.0 or over_b[0] * x + row_b < 0.0 or over_c[0] * x + row_c < 0.0:
                continue
            z = distance / (normal[0] * x + row_n)
            if z >= screen.near_m and not 0.0 < screen.depth_m[j, i] <= z:
                screen.depth_m[j, i] = z
                screen.triangle[j, i] = t


@kernel
def _pixel_range(corners: tuple[Vec3, Vec3, Vec3], screen: _Screen) -> tuple[int, int, int, int]:
    """Return the first and last row and column that a triangle can cover: all, where it reaches too near."""
    a, b, c = corners
    height, width = screen.triangle.shape
    if min(a[2], b[2], c[2]) < screen.near_m:
        return 0, height - 1, 0, width - 1
    optics = screen.intrinsics
    u = (a[0] / a[2], b[0] / b[2], c[0] / c[2])
    v = (a[1] / a[2], b[1] / b[2], c[1] / c[2])
    first_row = optics.focal_v_px * min(v) + optics.centre_v_px - 0.5 - _MARGIN_PX
    last_row = optics.focal_v_px * max(v) + optics.centre_v_px - 0.5 + _MARGIN_PX
    first_column = optics.focal_u_px * min(u) + optics.centre_u_px - 0.5 - _MARGIN_PX
    last_column = optics.focal_u_px * max(u) + optics.centre_u_px - 0.5 + _MARGIN_PX
    return (
        int(min(max(first_row, 0.0), height)),
        int(max(min(last_row, height - 1.0), -1.0)),
        int(min(max(first_column, 0.0), width)),
        int(max(min(last_column, width - 1.0), -1.0)),
    )


class Label(IntEnum):
    """What a pixel shows; the values are those of the `segmentation` picture."""

    NOTHING = 0
    BASE = 1
    PEG = 2
    LEFT_GEL = 3
    RIGHT_GEL = 4
    CLUTTER_OF_BASE = 5  # in the base's colour
    CLUTTER_OF_PEG = 6  # in the peg's
    TABLE = 7
    WALL = 8


class VerticesDoNotFit(VitacError):
    """Positions were given that do not fit the bodies of a scene; the message names the shapes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Closed surface of one body.

    Attributes:
        vertex_count: number of its vertices; a gel's are all its nodes.
        triangles: vertex indices, counter-clockwise seen from outside, shape [t, 3].
        label: what its pixels are called.
    """

    vertex_count: int
    triangles: IndexArray
    label: Label


class VisibleSurfaces:
    """The triangles of several bodies in one list, made once; only their vertices change between pictures.

    Attributes:
        triangles: indices into the vertices of all bodies, one body after the other, shape [t, 3].
        labels: label of every triangle, shape [t].
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        counts = [body.vertex_count for body in bodies]
        starts = np.concatenate([[0], np.cumsum(counts)])
        self._shapes = [(count, 3) for count in counts]
        self.triangles: IndexArray = np.ascontiguousarray(
            np.concatenate([body.triangles + start for body, start in zip(bodies, starts[:-1], strict=True)])
        )
        self.labels: NDArray[np.uint8] = np.repeat(
            np.array([body.label for body in bodies], dtype=np.uint8), [len(body.triangles) for body in bodies]
        )

    def vertices_m(self, positions_m: Sequence[FloatArray]) -> FloatArray:
        """Join the bodies' vertex positions in the world [m] to one array, shape [n, 3].

        Raises:
            VerticesDoNotFit: a body is missing, or has another number of vertices.
        """
        shapes = [position.shape for position in positions_m]
        if shapes != self._shapes:
            raise VerticesDoNotFit(f"Positions have the shapes {shapes}, expected {self._shapes}.")
        return np.concatenate(positions_m)
