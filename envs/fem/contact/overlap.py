"""Finds bodies that overlap, which the barrier cannot push apart: a scene must start without."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel, kernel
from ..algebra import Vec3, cross, dot, load, subtract
from ..model.model import Surfaces
from .broad_phase import IndexArray, Search, find_body_boxes, write_near_rows

FloatArray = NDArray[np.float64]

_NOWHERE = -1


class Overlap(NamedTuple):
    """Two bodies that overlap, and the crossing edge and triangle in point indices; -1 where one encloses the other."""

    first_body: int
    second_body: int
    edge: int
    triangle: int


@allocating_kernel
def find_overlap(surfaces: Surfaces, y: FloatArray) -> Overlap:
    """Return the first pair of bodies that cross or of which one lies inside the other; all -1 if there is none.

    Points y [m] have shape [p, 3].
    """
    search = Search(surfaces, y, find_body_boxes(surfaces, y), 0.0)
    for k in range(len(surfaces.pairs)):
        a, b = surfaces.pairs[k, 0], surfaces.pairs[k, 1]
        edge, triangle = _crossing(search, a, b)
        if edge == _NOWHERE:
            edge, triangle = _crossing(search, b, a)
        if edge != _NOWHERE or _encloses(surfaces, y, a, b) or _encloses(surfaces, y, b, a):
            return Overlap(a, b, edge, triangle)
    return Overlap(_NOWHERE, _NOWHERE, _NOWHERE, _NOWHERE)


@allocating_kernel
def _crossing(search: Search, a: int, b: int) -> tuple[int, int]:
    """Return an edge of body a and a triangle of body b that cross."""
    surfaces, y = search.surfaces, search.y
    edges = _near_rows(search, surfaces.edges, surfaces.edge_start[a : a + 2], b)
    triangles = _near_rows(search, surfaces.triangles, surfaces.triangle_start[b : b + 2], a)
    for e in edges:
        p, q = load(y, surfaces.edges[e, 0]), load(y, surfaces.edges[e, 1])
        for t in triangles:
            corners = surfaces.triangles
            if segment_crosses_triangle(
                p,
                q,
                load(y, corners[t, 0]),
                load(y, corners[t, 1]),
                load(y, corners[t, 2]),
            ):
                return e, t
    return _NOWHERE, _NOWHERE


@allocating_kernel
def _near_rows(search: Search, rows: IndexArray, span: IndexArray, other: int) -> IndexArray:
    """Return the rows (edges or triangles) of a span whose box meets that of body `other`."""
    found = np.empty(span[1] - span[0], np.int64)
    return found[: write_near_rows(search, rows, (span[0], span[1]), other, found)]


@kernel
def segment_crosses_triangle(p: Vec3, q: Vec3, a: Vec3, b: Vec3, c: Vec3) -> bool:
    """Return whether segment (p, q) crosses triangle (a, b, c); in one plane with it they do not cross."""
    pq = subtract(q, p)
    pa, pb, pc = subtract(a, p), subtract(b, p), subtract(c, p)
    normal = cross(subtract(b, a), subtract(c, a))
    if dot(pa, normal) * dot(subtract(a, q), normal) > 0.0:
        return False
    u, v, w = dot(pq, cross(pc, pb)), dot(pq, cross(pa, pc)), dot(pq, cross(pb, pa))
    return (u > 0.0 and v > 0.0 and w > 0.0) or (u < 0.0 and v < 0.0 and w < 0.0)


@kernel
def _encloses(surfaces: Surfaces, y: FloatArray, outer: int, inner: int) -> bool:
    """Return whether a body holds the first point of another: a ray crosses its surface an odd number of times."""
    start = load(y, surfaces.point_start[inner])
    far = (start[0] + 0.8191, start[1] + 1.3147, start[2] + 1.0773)
    inside = False
    for t in range(surfaces.triangle_start[outer], surfaces.triangle_start[outer + 1]):
        corners = surfaces.triangles
        if segment_crosses_triangle(
            start,
            far,
            load(y, corners[t, 0]),
            load(y, corners[t, 1]),
            load(y, corners[t, 2]),
        ):
            inside = not inside
    return inside
