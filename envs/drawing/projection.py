"""A drawing's camera, what it sees of the scene in its frame, and cuts through solids."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

from ..scene.perspective import Plane
from ..vision.camera import Sight
from ..vision.optics import HEIGHT_PX, WIDTH_PX
from ..vision.rasterizer import Label

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ParallelCamera:
    """Looks at a point from a direction; the world's z is up in the picture.

    Attributes:
        azimuth_deg: where the eye stands, about z, counter-clockwise from +x [deg].
        elevation_deg: height of the eye above the horizon [deg], less than 90 either way.
        centre_m: the point in the middle of the picture [m].
        height_m: what the picture shows from its lower to its upper edge [m].
        width_px: pixels across.
        height_px: pixels from top to bottom.
    """

    azimuth_deg: float
    elevation_deg: float
    centre_m: tuple[float, float, float]
    height_m: float
    width_px: int
    height_px: int

    @cached_property
    def axes(self) -> FloatArray:
        """Unit vectors to the right, upwards, and away from the eye, as rows, shape [3, 3]."""
        a, e = radians(self.azimuth_deg), radians(self.elevation_deg)
        right = (-sin(a), cos(a), 0.0)
        up = (-cos(a) * sin(e), -sin(a) * sin(e), cos(e))
        away = (-cos(a) * cos(e), -sin(a) * cos(e), -sin(e))
        return np.array([right, up, away])

    def project(self, points_m: FloatArray) -> FloatArray:
        """Return picture coordinates of points: x to the right, y downwards [pixel], depth [m], shape [..., 3]."""
        seen = (points_m - np.array(self.centre_m)) @ self.axes.T
        scale = self.height_px / self.height_m
        x = 0.5 * self.width_px + scale * seen[..., 0]
        y = 0.5 * self.height_px - scale * seen[..., 1]
        return np.stack([x, y, seen[..., 2]], axis=-1)

    def plane_depths_m(self, plane: Plane) -> FloatArray:
        """Return a plane's depth behind every pixel's centre [m], shape [height, width]; it must not be edge-on."""
        right, up, away = self.axes @ np.array(plane.normal)
        start = float(plane.heights_m(np.array(self.centre_m)))
        metre = self.height_m / self.height_px
        x = (np.arange(self.width_px) + 0.5 - 0.5 * self.width_px) * metre
        y = (0.5 * self.height_px - np.arange(self.height_px) - 0.5) * metre
        return np.asarray(-(start + right * x[None, :] + up * y[:, None]) / away)


_MARGIN_PX = 10


@dataclass(frozen=True, kw_only=True)
class PictureCrop:
    """The part of a picture that is shown, and the depths that colours stand for.

    Attributes:
        rows: from the first to behind the last.
        columns: the same across.
        nearest_mm: smallest depth of the scale.
        farthest_mm: largest depth of the scale.
    """

    rows: slice
    columns: slice
    nearest_mm: float
    farthest_mm: float

    @classmethod
    def around(cls, sights: Sequence[Sight]) -> "PictureCrop":
        """Return the frame around all bodies that are ever seen, with a scale for the first and last depth picture."""
        empty = (Label.NOTHING, Label.TABLE, Label.WALL)
        shown = np.any([~np.isin(sight.segmentation, empty) for sight in sights], axis=0)
        depths_mm = 1e3 * np.concatenate([sight.depth_m[sight.depth_m > 0] for sight in (sights[0], sights[-1])])
        low, high = np.quantile(depths_mm, (0.01, 0.99)) if len(depths_mm) else (0.0, 1000.0)
        return cls(
            rows=widened(np.flatnonzero(shown.any(axis=1)), HEIGHT_PX),
            columns=widened(np.flatnonzero(shown.any(axis=0)), WIDTH_PX),
            nearest_mm=float(low),
            farthest_mm=float(high),
        )


def widened(places: NDArray[np.int64], end: int) -> slice:
    """Return the range of places with a margin, within 0 and `end`; all of it where there is no place."""
    if len(places) == 0:
        return slice(0, end)
    return slice(max(0, int(places.min()) - _MARGIN_PX), min(end, int(places.max()) + 1 + _MARGIN_PX))


IndexArray = NDArray[np.int64]


def section_loops_m(vertices_m: FloatArray, triangles: IndexArray, plane: Plane) -> list[FloatArray]:
    """Return the closed outlines where a plane cuts a closed surface, each [k, 3] [m], the first point not repeated.

    Seen against the plane's normal, material lies to the left of an outline, so that outlines of holes turn the other
    way. A vertex exactly on the plane counts as above it.
    """
    following = dict(_crossings(triangles, plane.heights_m(vertices_m) >= 0.0))
    heights = plane.heights_m(vertices_m)
    loops = []
    while following:
        edge, after = following.popitem()
        loop = [_crossing_point(vertices_m, heights, edge)]
        while after != edge:
            loop.append(_crossing_point(vertices_m, heights, after))
            after = following.pop(after)
        loops.append(np.array(loop))
    return loops


Edge = tuple[int, int]


def _crossings(triangles: IndexArray, above: NDArray[np.bool_]) -> list[tuple[Edge, Edge]]:
    """Return the edges by which the outline enters and leaves each triangle that the plane cuts."""
    cut = above[triangles].any(axis=1) & ~above[triangles].all(axis=1)
    return [_entry_and_exit(triangle, above) for triangle in triangles[cut].tolist()]


def _entry_and_exit(triangle: list[int], above: NDArray[np.bool_]) -> tuple[Edge, Edge]:
    """Return the two crossings of an outline: in by the edge that falls through the plane, out by the rising one."""
    edges = [(triangle[i], triangle[(i + 1) % 3]) for i in range(3)]
    falling = next(edge for edge in edges if above[edge[0]] and not above[edge[1]])
    rising = next(edge for edge in edges if not above[edge[0]] and above[edge[1]])
    return _undirected(falling), _undirected(rising)


def _undirected(edge: Edge) -> Edge:
    return (edge[0], edge[1]) if edge[0] < edge[1] else (edge[1], edge[0])


def _crossing_point(vertices_m: FloatArray, heights: FloatArray, edge: Edge) -> FloatArray:
    a, b = edge
    part = heights[a] / (heights[a] - heights[b])
    return np.asarray(vertices_m[a] + part * (vertices_m[b] - vertices_m[a]))
