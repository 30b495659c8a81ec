"""Triangulation of plane polygons with holes, by ear clipping. Used by the solids for their flat faces."""

from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray

from .polygon import Polygon, orientation, segments_touch

Triangle = tuple[int, int, int]


def triangulate(outline: Polygon, holes: tuple[Polygon, ...] = ()) -> list[Triangle]:
    """Return the counter-clockwise triangles of a polygon with holes that adds no corner.

    Corners are numbered through the outline and then through each hole. The outline runs counter-clockwise; holes may
    run either way. Each hole is joined to the outline by its shortest free bridge, then ears are clipped, the one with
    the shortest cut first, so equal input gives equal triangles.
    """
    points = np.concatenate([outline, *holes])
    loops = _loops(outline, holes)
    ring = loops[0]
    remaining = loops[1:]
    while remaining:
        ring_corner, hole_index, hole_corner = _shortest_bridge(points, ring, remaining)
        hole = remaining.pop(hole_index)
        ring = _joined(ring, ring_corner, hole, hole_corner)
    return _clip_ears(points, ring)


def _loops(outline: Polygon, holes: tuple[Polygon, ...]) -> list[list[int]]:
    """Return the corner indices of the outline (counter-clockwise) and of every hole (clockwise)."""
    loops = [list(range(len(outline)))]
    start = len(outline)
    for hole in holes:
        loop = list(range(start, start + len(hole)))
        clockwise = _twice_area(hole) < 0
        loops.append(loop if clockwise else loop[::-1])
        start += len(hole)
    return loops


def _twice_area(polygon: Polygon) -> float:
    following = np.roll(polygon, -1, axis=0)
    return float((polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]).sum())


def _shortest_bridge(points: NDArray[np.float64], ring: list[int], holes: list[list[int]]) -> tuple[int, int, int]:
    """Return the position in the ring, hole, and position in that hole of the shortest segment that crosses no edge."""
    edges = list(chain.from_iterable(pairwise([*loop, loop[0]]) for loop in (ring, *holes)))
    candidates = sorted(
        (_squared_length(points, ring[r], hole[k]), r, h, k)
        for h, hole in enumerate(holes)
        for r in range(len(ring))
        for k in range(len(hole))
    )
    for _, r, h, k in candidates:
        if _is_free(points, ring[r], holes[h][k], edges):
            return r, h, k
    raise AssertionError("A hole inside its outline always sees it.")  # pragma: no cover


def _is_free(points: NDArray[np.float64], a: int, b: int, edges: list[tuple[int, int]]) -> bool:
    return not any(
        segments_touch(points[a], points[b], points[c], points[d]) for c, d in edges if len({a, b, c, d}) == 4
    )


def _joined(ring: list[int], r: int, hole: list[int], k: int) -> list[int]:
    return [*ring[: r + 1], *hole[k:], *hole[: k + 1], *ring[r:]]


def _clip_ears(points: NDArray[np.float64], ring: list[int]) -> list[Triangle]:
    ring = list(ring)
    triangles = []
    while len(ring) > 3:
        ears = [i for i in range(len(ring)) if _is_ear(points, ring, i)]
        ear = min(ears, key=lambda i: _squared_length(points, ring[i - 1], ring[(i + 1) % len(ring)]))
        triangles.append(_corner(ring, ear))
        del ring[ear]
    return [*triangles, (ring[0], ring[1], ring[2])]


def _corner(ring: list[int], i: int) -> Triangle:
    return ring[i - 1], ring[i], ring[(i + 1) % len(ring)]


def _is_ear(points: NDArray[np.float64], ring: list[int], i: int) -> bool:
    a, b, c = _corner(ring, i)
    if orientation(points[a], points[b], points[c]) <= 0:
        return False
    return not any(_is_in_triangle(points, a, b, c, other) for other in set(ring) - {a, b, c})


def _is_in_triangle(points: NDArray[np.float64], a: int, b: int, c: int, other: int) -> bool:
    """Return whether a point lies in the closed triangle."""
    return all(orientation(points[i], points[j], points[other]) >= 0 for i, j in ((a, b), (b, c), (c, a)))


def _squared_length(points: NDArray[np.float64], a: int, b: int) -> float:
    x, y = points[a] - points[b]
    return float(x * x + y * y)
