"""Which triangle is seen in each pixel: a depth buffer in numpy, for the few hundred triangles of a scene.

Painter's algorithm, which plotting libraries use, orders whole triangles and fails where a peg stands in a hole.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...scene.perspective import Plane
from .camera import ParallelCamera

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
