"""Which faces and edges of a drawing are seen, and how they are shaded."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..scene.perspective import Plane
from .projection import ParallelCamera

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

NOTHING = -1
# A pixel on the edge that two triangles share must belong to at least one of them.
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Visible:
    """What is seen, per pixel.

    Attributes:
        triangle: number of the triangle, counted over all that were added, or NOTHING, shape [height, width].
        weights: barycentric weights of its corners 1 and 2, shape [height, width, 2].
        depth_m: distance along the line of sight [m], infinite where nothing is, shape [height, width].
    """

    triangle: NDArray[np.int32]
    weights: NDArray[np.float32]
    depth_m: FloatArray

    @classmethod
    def nothing(cls, camera: ParallelCamera) -> "Visible":
        """Return an empty picture."""
        shape = (camera.height_px, camera.width_px)
        return cls(
            triangle=np.full(shape, NOTHING, dtype=np.int32),
            weights=np.zeros((*shape, 2), dtype=np.float32),
            depth_m=np.full(shape, np.inf),
        )

    def copy(self) -> "Visible":
        """Return a picture to which more can be added."""
        return Visible(triangle=self.triangle.copy(), weights=self.weights.copy(), depth_m=self.depth_m.copy())

    def add(self, corners: FloatArray, *, first: int, kept_m: FloatArray | None = None) -> None:
        """Put triangles where nothing nearer is.

        Args:
            corners: picture coordinates of their corners (x, y, depth), shape [t, 3, 3].
            first: number of the first of them.
            kept_m: only where this value, linear over a triangle, is not negative, is a triangle there at all; values
                at the corners, shape [t, 3].
        """
        for index, triangle in enumerate(corners):
            kept = None if kept_m is None else kept_m[index]
            if kept is None or (kept >= 0.0).any():
                self._add_one(triangle, first + index, kept)

    def _add_one(self, corners: FloatArray, number: int, kept_m: FloatArray | None) -> None:
        (x0, y0), (x1, y1), (x2, y2) = corners[:, :2].tolist()
        doubled_area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        rows, columns = self._window(corners)
        if doubled_area == 0.0 or rows.start >= rows.stop or columns.start >= columns.stop:
            return
        x = np.arange(columns.start, columns.stop)[None, :] + (0.5 - x0)
        y = np.arange(rows.start, rows.stop)[:, None] + (0.5 - y0)
        w1 = (x * (y2 - y0) - (x2 - x0) * y) / doubled_area
        w2 = ((x1 - x0) * y - x * (y1 - y0)) / doubled_area
        d0, d1, d2 = corners[:, 2]
        depth = d0 + w1 * (d1 - d0) + w2 * (d2 - d0)
        on_it = (w1 >= -_ROUNDING) & (w2 >= -_ROUNDING) & (w1 + w2 <= 1.0 + _ROUNDING)
        seen = on_it & (depth < self.depth_m[rows, columns])
        if kept_m is not None:
            seen &= kept_m[0] + w1 * (kept_m[1] - kept_m[0]) + w2 * (kept_m[2] - kept_m[0]) >= 0.0
        self.depth_m[rows, columns][seen] = depth[seen]
        self.triangle[rows, columns][seen] = number
        self.weights[rows, columns][seen] = np.stack([w1[seen], w2[seen]], axis=1)

    def _window(self, corners: FloatArray) -> tuple[slice, slice]:
        """Return the rows and columns of pixels that a triangle may touch."""
        height, width = self.depth_m.shape
        low = np.floor(corners[:, :2].min(axis=0)).astype(int)
        high = np.ceil(corners[:, :2].max(axis=0)).astype(int)
        return slice(max(low[1], 0), min(high[1], height)), slice(max(low[0], 0), min(high[0], width))

    def close_cut(self, plane: Plane, camera: ParallelCamera, inside: NDArray[np.bool_]) -> None:
        """Bring pixels that look into a cut-open solid forward to the cut, so that nothing in the solid shows through.

        Args:
            plane: the cut.
            camera: the picture's.
            inside: pixels whose triangle is seen from inside the solid, shape [height, width].
        """
        self.depth_m[inside] = camera.plane_depths_m(plane)[inside]

    def interpolated(self, corner_values: FloatArray, number: NDArray[np.int32], here: NDArray[np.bool_]) -> FloatArray:
        """Return the values at pixels, linear over each triangle, shape [k].

        Args:
            corner_values: of some triangles, shape [t, 3].
            number: which of these triangles is in each pixel, shape [k].
            here: the pixels, shape [height, width], k of them true.
        """
        w1, w2 = self.weights[here].T
        v0, v1, v2 = corner_values[number].T
        return np.asarray(v0 + w1 * (v1 - v0) + w2 * (v2 - v0))

    def hides(self, points: FloatArray, *, slack_m: float) -> NDArray[np.bool_]:
        """Return whether something is more than `slack_m` nearer than each point (x, y, depth), shape [n, 3] to [n].

        Points outside the picture are hidden.
        """
        height, width = self.depth_m.shape
        column, row = np.floor(points[:, 0]).astype(int), np.floor(points[:, 1]).astype(int)
        outside = (column < 0) | (column >= width) | (row < 0) | (row >= height)
        nearest = self.depth_m[row.clip(0, height - 1), column.clip(0, width - 1)]
        return np.asarray(outside | (points[:, 2] > nearest + slack_m))


# Faces that meet at less than this have no edge between them.
_SMOOTH_DEG = 12.0
_SAMPLE_DISTANCE_PX = 2.0
# An edge lies on the surface that it bounds; only what is nearer than this hides it.
_SLACK_M = 4e-4


def sharp_edges(vertices_m: FloatArray, triangles: IndexArray) -> IndexArray:
    """Return the edges at which a closed surface has a fold, vertex indices, shape [e, 2]."""
    normals = unit_normals(vertices_m, triangles)
    first: dict[tuple[int, int], int] = {}
    sharp = []
    for number, triangle in enumerate(triangles.tolist()):
        for i in range(3):
            a, b = sorted((triangle[i], triangle[(i + 1) % 3]))
            other = first.setdefault((a, b), number)
            if other != number and normals[number] @ normals[other] < np.cos(np.radians(_SMOOTH_DEG)):
                sharp.append((a, b))
    return np.array(sharp, dtype=np.int64).reshape(-1, 2)


def unique_edges(triangles: IndexArray) -> IndexArray:
    """Return all edges of a closed surface, each once, shape [e, 2]."""
    directed = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    return np.asarray(directed[directed[:, 0] < directed[:, 1]])


def unit_normals(vertices_m: FloatArray, triangles: IndexArray) -> FloatArray:
    """Return the outward unit normals of triangles, shape [t, 3]."""
    corners = vertices_m[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def visible_lines(
    ends_m: FloatArray, camera: ParallelCamera, visible: Visible, *, kept_m: FloatArray | None = None
) -> list[FloatArray]:
    """Return the visible parts of straight lines, as polylines in picture coordinates [pixel], each [k, 2].

    Args:
        ends_m: both ends of every line in the world [m], shape [l, 2, 3].
        camera: the picture's.
        visible: everything that may hide them.
        kept_m: a line is only there where this value, linear along it, is not negative; values at the ends,
            shape [l, 2].
    """
    ends = camera.project(ends_m)
    lengths_px = np.abs(ends[:, 1, :2] - ends[:, 0, :2]).max(axis=1)
    samples = np.maximum(2, (lengths_px / _SAMPLE_DISTANCE_PX).astype(int) + 1)
    line = np.repeat(np.arange(len(ends)), samples)
    within = np.arange(len(line)) - (np.cumsum(samples) - samples)[line]
    part = (within / (samples[line] - 1))[:, None]
    points = (1.0 - part) * ends[line, 0] + part * ends[line, 1]
    seen = ~visible.hides(points, slack_m=_SLACK_M)
    if kept_m is not None:
        seen &= (1.0 - part[:, 0]) * kept_m[line, 0] + part[:, 0] * kept_m[line, 1] >= -1e-9
    return [points[run, :2] for run in _runs(seen, line)]


def _runs(seen: NDArray[np.bool_], line: IndexArray) -> list[slice]:
    """Return the stretches of at least two points of one line that are all seen."""
    changes = np.flatnonzero((seen[1:] != seen[:-1]) | (line[1:] != line[:-1])) + 1
    bounds = np.concatenate([[0], changes, [len(seen)]]).tolist()
    return [slice(start, stop) for start, stop in pairwise(bounds) if stop - start > 1 and seen[start]]


# Colours, shape [k, 4] in 0 to 1, of values, shape [k].
ColourMap = Callable[[FloatArray], FloatArray]

HELD_COLOUR = (0.56, 0.65, 0.76)
FIXED_COLOUR = (0.91, 0.88, 0.82)
CUT_COLOUR = (0.82, 0.76, 0.65)

# Towards the light: to the right, upwards, and against the line of sight.
_LIGHT = np.array([0.30, 0.78, -0.55])
# How much darker a face is that no light falls on; little where its colour has a meaning.
_MATT_SHADE, _COLOURED_SHADE = 0.28, 0.12
_GLASS_OPACITY = 0.34


def lit(rgb: FloatArray, normals: FloatArray, *, matt: bool = True) -> FloatArray:
    """Return the colours of faces as the light makes them.

    Args:
        rgb: their own colours in 0 to 1, shape [3] or [k, 3].
        normals: outward unit normals as right, up and away from the eye, shape [k, 3].
        matt: False where a colour stands for a value and must stay readable.
    """
    shade = _MATT_SHADE if matt else _COLOURED_SHADE
    light = (normals @ _LIGHT).clip(0.0, 1.0)
    return np.asarray(rgb * (1.0 - shade + shade * light)[:, None])


def seen_through(glass: FloatArray, behind: FloatArray, is_glass: NDArray[np.bool_]) -> FloatArray:
    """Return two pictures, shape [height, width, 3], one over the other: the first is glass where the mask says so."""
    mixed = behind.copy()
    mixed[is_glass] = _GLASS_OPACITY * glass[is_glass] + (1.0 - _GLASS_OPACITY) * behind[is_glass]
    return mixed


def averaged(rgb: FloatArray, block: int) -> FloatArray:
    """Return the means over blocks of pixels, shape [block h, block w, 3] to [h, w, 3]."""
    height, width = rgb.shape[0] // block, rgb.shape[1] // block
    return np.asarray(rgb.reshape(height, block, width, block, 3).mean(axis=(1, 3)))
