"""The upper side of a drawn gel as heights over its base: its faces, walls and creases, and the height anywhere."""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import sqrt

import numpy as np
from numpy.typing import NDArray
from vitac.errors import VitacError

from ..compilation import allocating_kernel, kernel
from .plane_mesh import GRID_PER_MM, PlaneMesh, Point, TooManyPoints
from .surface import DrawnSurface, first_within, heights_mm

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
class MeshLine:
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

    def lines(self, *, crease_cosine: float) -> Iterator[MeshLine]:
        """Yield walls, and creases whose faces' normals have a smaller cosine than this."""
        surface = self._surface
        first, second = surface.triangles_of_edges.T
        cosine = (surface.normals[first] * surface.normals[second]).sum(axis=1)
        both = self._is_upper[first] & self._is_upper[second]
        is_wall = self._is_upper[first] ^ self._is_upper[second]
        for index in np.flatnonzero(is_wall | (both & (cosine < crease_cosine))):
            (ax, ay, _), (bx, by, _) = surface.vertices_mm[surface.edges[index]].tolist()
            yield MeshLine(first=(ax, ay), second=(bx, by), is_wall=bool(is_wall[index]))


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


PlanePoint = tuple[float, float]
Pieces = dict[frozenset[PlanePoint], bool]

# Ends of lines that are closer are one point, and a point that is closer to a line is on it.
_SNAP_MM = 0.01
# Corners are left away where the outline then moves by less.
_STRAIGHT_MM = 0.04
_MAX_ENDS = 4000


def add_outlines(plane: PlaneMesh, lines: list[MeshLine], half_mm: PlanePoint) -> None:
    """Add lines to a plane mesh.

    Args:
        plane: mesh of the base.
        lines: outlines of faces.
        half_mm: half the extent of the base along x and y.

    Raises:
        TooManyPoints: the outlines alone have more corners than the mesh may have points.
    """
    for first, second, is_wall in _simplified(_pieces(lines, half_mm)):
        a, b = (plane.add_point((snap_to_grid(x), snap_to_grid(y))) for x, y in (first, second))
        if a != b:
            plane.add_segment(a, b, is_wall=is_wall)


def snap_to_grid(value_mm: float) -> int:
    """Return a coordinate of the plane mesh."""
    return round(value_mm * GRID_PER_MM)


def convert_to_mm(point: Point) -> PlanePoint:
    """Return x and y of a point of the plane mesh [mm]."""
    return point[0] / GRID_PER_MM, point[1] / GRID_PER_MM


def _pieces(lines: list[MeshLine], half_mm: PlanePoint) -> Pieces:
    """Return all lines cut where the ends of others lie on them, each piece once; not those on the base's edge."""
    ends = _snapped([end for line in lines for end in (line.first, line.second)], half_mm)
    points = np.array([*dict.fromkeys(ends)]).reshape(-1, 2)
    pieces: Pieces = {}
    for index, line in enumerate(lines):
        first, second = ends[2 * index], ends[2 * index + 1]
        if any(a == b and abs(a) == h for a, b, h in zip(first, second, half_mm, strict=True)):
            continue
        between = _sample_points(points, np.array(first), np.array(second)).tolist()
        for a, b in pairwise(between):
            piece = frozenset((tuple(a), tuple(b)))
            pieces[piece] = line.is_wall or pieces.get(piece, False)
    return pieces


def _snapped(ends: list[PlanePoint], half_mm: PlanePoint) -> list[PlanePoint]:
    """Return the points with those that are close together made equal, and those close to the base's edge put on it."""
    distinct = [*dict.fromkeys(ends)]
    points = [tuple(_to_edge(value, limit) for value, limit in zip(end, half_mm, strict=True)) for end in distinct]
    firsts = first_within(np.array(points).reshape(-1, 2), _SNAP_MM).tolist()
    if len(set(firsts)) > _MAX_ENDS:
        raise TooManyPoints(f"The outlines of the faces have more than {_MAX_ENDS} corners.")
    snapped = {end: points[first] for end, first in zip(distinct, firsts, strict=True)}
    return [snapped[end] for end in ends]


def _sample_points(points: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the points on a line in the order from its first end to its second, both included, shape [n, 2]."""
    along = second - first
    squared = float((along * along).sum())
    if squared == 0.0:
        return first[None]
    fraction = ((points - first) * along).sum(axis=1) / squared
    off = points - (first + fraction[:, None] * along)
    on_line = (fraction >= 0.0) & (fraction <= 1.0) & ((off * off).sum(axis=1) <= _SNAP_MM * _SNAP_MM)
    return np.asarray(points[on_line][np.argsort(fraction[on_line], kind="stable")])


def _simplified(pieces: Pieces) -> list[tuple[PlanePoint, PlanePoint, bool]]:
    """Return the pieces with chains of them replaced by fewer; points where chains meet stay."""
    around: dict[PlanePoint, list[PlanePoint]] = defaultdict(list)
    for piece in sorted(pieces, key=sorted):
        a, b = sorted(piece)
        around[a].append(b)
        around[b].append(a)

    def is_inner(point: PlanePoint) -> bool:
        neighbours = around[point]
        return len(neighbours) == 2 and len({pieces[frozenset((point, n))] for n in neighbours}) == 1

    left = dict.fromkeys(sorted(pieces, key=sorted))
    segments = []
    # Chains between fixed points first; what is left then are closed rings, each begun at its lowest point.
    for start in [*(point for point in sorted(around) if not is_inner(point)), *sorted(around)]:
        for neighbour in around[start]:
            if frozenset((start, neighbour)) in left:
                chain = _chain(start, neighbour, around, is_inner, left)
                kept = _straightened(chain)
                is_wall = pieces[frozenset(chain[:2])]
                segments += [(a, b, is_wall) for a, b in pairwise(kept)]
    return segments


def _chain(
    start: PlanePoint,
    neighbour: PlanePoint,
    around: dict[PlanePoint, list[PlanePoint]],
    is_inner: Callable[[PlanePoint], bool],
    left: dict[frozenset[PlanePoint], None],
) -> list[PlanePoint]:
    """Take the pieces from one point on out of those that are left, up to the next fixed point or around a ring."""
    chain = [start, neighbour]
    del left[frozenset(chain)]
    while chain[-1] != start and is_inner(chain[-1]):
        following = next(point for point in around[chain[-1]] if point != chain[-2])
        del left[frozenset((chain[-1], following))]
        chain.append(following)
    return chain


def _straightened(chain: list[PlanePoint]) -> list[PlanePoint]:
    """Return a chain without the corners that lie close to the line between others (Douglas & Peucker 1973).

    A ring is first cut at the point that is farthest from its beginning.
    """
    points, kept = np.array(chain), {0, len(chain) - 1}
    waiting = [(0, len(chain) - 1)]
    while waiting:
        first, last = waiting.pop()
        off_mm = _distances_mm(points[first : last + 1], points[first], points[last])
        if off_mm.max() > _STRAIGHT_MM:
            middle = first + int(off_mm.argmax())
            kept.add(middle)
            waiting += [(first, middle), (middle, last)]
    return [chain[index] for index in sorted(kept)]


def _distances_mm(points: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the distances of points from a line between two points, or from them where they are one, shape [n]."""
    x, y = (points - first).T
    along_x, along_y = second - first
    length = sqrt(along_x * along_x + along_y * along_y)
    return np.asarray(np.sqrt(x * x + y * y) if length == 0.0 else np.abs(along_x * y - along_y * x) / length)


def _to_edge(value: float, limit: float) -> float:
    return limit if abs(value - limit) <= _SNAP_MM else -limit if abs(value + limit) <= _SNAP_MM else value
