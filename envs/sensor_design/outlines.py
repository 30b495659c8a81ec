"""Puts the outlines of a gel's faces into the plane mesh: snapped, cut where they meet, without needless corners."""

from collections import defaultdict
from collections.abc import Callable
from itertools import pairwise
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from .height_field import Line
from .plane_mesh import GRID_PER_MM, PlaneMesh, Point, TooManyPoints
from .surface import first_within

FloatArray = NDArray[np.float64]
PlanePoint = tuple[float, float]
Pieces = dict[frozenset[PlanePoint], bool]

# Ends of lines that are closer are one point, and a point that is closer to a line is on it.
_SNAP_MM = 0.01
# Corners are left away where the outline then moves by less.
_STRAIGHT_MM = 0.04
_MAX_ENDS = 4000


def add_outlines(plane: PlaneMesh, lines: list[Line], half_mm: PlanePoint) -> None:
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


def _pieces(lines: list[Line], half_mm: PlanePoint) -> Pieces:
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
    found = []
    # Chains between fixed points first; what is left then are closed rings, each begun at its lowest point.
    for start in [*(point for point in sorted(around) if not is_inner(point)), *sorted(around)]:
        for neighbour in around[start]:
            if frozenset((start, neighbour)) in left:
                chain = _chain(start, neighbour, around, is_inner, left)
                kept = _straightened(chain)
                is_wall = pieces[frozenset(chain[:2])]
                found += [(a, b, is_wall) for a, b in pairwise(kept)]
    return found


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
