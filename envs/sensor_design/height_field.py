"""The upper side of a drawn gel as heights over its base: its faces, walls and creases, and the height anywhere."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..compilation import allocating_kernel, kernel
from ..errors import VitacError
from .surface import DrawnSurface, heights_mm

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
MaskArray = NDArray[np.bool_]

# A face that leans less than this from the vertical (as sine) is a wall.
_WALL_SINE = 1e-3
# A face that looks down is one, too, where it stands out less than this.
_OVERHANG_MM = 0.01
# Points of the base are within this of its lowest point.
_FLAT_MM = 0.02


class NotAHeightField(VitacError):
    """A gel has more than one height over a point of its base: it has to bring its own mesh."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """A straight line in the plane that the edges of a mesh have to follow.

    Attributes:
        first: one end, x and y [mm].
        second: the other end.
        is_wall: the height jumps across it.
    """

    first: tuple[float, float]
    second: tuple[float, float]
    is_wall: bool


class HeightField:
    """Heights of a closed, outward surface over its flat base, which is at height 0.

    Args:
        surface: with its base at z = 0.

    Raises:
        NotAHeightField: a face other than the base looks down.
    """

    def __init__(self, surface: DrawnSurface) -> None:
        self._surface = surface
        self._slope = surface.normals[:, 2]
        self._is_upper: MaskArray = self._slope > _WALL_SINE
        down = self._slope < -_WALL_SINE
        is_low: MaskArray = surface.corners_mm[:, :, 2].max(axis=1) <= _FLAT_MM
        overhanging = down & ~is_low & (heights_mm(surface.corners_mm * [1.0, 1.0, 0.0]) > _OVERHANG_MM)
        if overhanging.any():
            x, y, z = surface.corners_mm[int(np.flatnonzero(overhanging)[0])].mean(axis=0)
            raise NotAHeightField(
                f"{int(overhanging.sum())} triangles face the base from above, one at ({x:.2f}, {y:.2f}) mm, {z:.2f} "
                "mm above it: expected one height over every point of the base; bring a tet.msh for other shapes."
            )

    @cached_property
    def upper_corners_mm(self) -> FloatArray:
        """Corners of the faces that look up [mm], shape [f, 3, 3]."""
        return np.ascontiguousarray(self._surface.corners_mm[self._is_upper])

    @cached_property
    def upper_slopes(self) -> FloatArray:
        """Cosine of the angle between those faces and the base, shape [f]."""
        return np.asarray(self._slope[self._is_upper])

    def lines(self, *, crease_cosine: float) -> Iterator[Line]:
        """Yield walls, and creases whose faces' normals have a smaller cosine than this."""
        surface = self._surface
        first, second = surface.triangles_of_edges.T
        cosine = (surface.normals[first] * surface.normals[second]).sum(axis=1)
        both = self._is_upper[first] & self._is_upper[second]
        is_wall = self._is_upper[first] ^ self._is_upper[second]
        for index in np.flatnonzero(is_wall | (both & (cosine < crease_cosine))):
            (ax, ay, _), (bx, by, _) = surface.vertices_mm[surface.edges[index]].tolist()
            yield Line(first=(ax, ay), second=(bx, by), is_wall=bool(is_wall[index]))


@allocating_kernel
def heights_of_faces_mm(points: FloatArray, at: FloatArray, corners: FloatArray) -> FloatArray:
    """Return heights of faces' planes [mm], shape [n].

    Args:
        points: x and y of points; of the faces one that holds the point is taken, else the one nearest to doing so.
        at: where to take the height of that face's plane, shape [n, 2].
        corners: of the faces, shape [f, 3, 3].
    """
    out = np.empty(len(points))
    nearest = 0
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        if _depth(x, y, corners[nearest]) < 0.0:
            best = -np.inf
            for t in range(len(corners)):
                depth = _depth(x, y, corners[t])
                if depth > best:
                    best, nearest = depth, t
                    if best >= 0.0:
                        break
        out[i] = _plane_height(at[i, 0], at[i, 1], corners[nearest])
    return out


@kernel
def _depth(x: float, y: float, face: FloatArray) -> float:
    """Return how far a point lies inside the face in the plane, by its nearest edge; negative outside."""
    depth = np.inf
    for i in range(3):
        ax, ay = face[i, 0], face[i, 1]
        ex, ey = face[(i + 1) % 3, 0] - ax, face[(i + 1) % 3, 1] - ay
        length = np.sqrt(ex * ex + ey * ey)
        depth = min(depth, (ex * (y - ay) - ey * (x - ax)) / length if length > 0.0 else -np.inf)
    return depth


@kernel
def _plane_height(x: float, y: float, face: FloatArray) -> float:
    bx, by, bz = face[1, 0] - face[0, 0], face[1, 1] - face[0, 1], face[1, 2] - face[0, 2]
    cx, cy, cz = face[2, 0] - face[0, 0], face[2, 1] - face[0, 1], face[2, 2] - face[0, 2]
    px, py = x - face[0, 0], y - face[0, 1]
    area = bx * cy - by * cx
    height: float = face[0, 2] + (bz * (px * cy - py * cx) + cz * (bx * py - by * px)) / area
    return height
