"""Kernels that compare triangles with triangles or points: self-intersection and the distance between surfaces."""

import numpy as np
from numpy.typing import NDArray

from ..compilation import allocating_kernel, kernel
from ..fem.algebra import Vec3, cross, dot, load, subtract
from ..fem.contact.distance import POINT_TRIANGLE, closest_points

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

NONE = -1
TOO_MANY = -2
# Cosine of the angle between two neighbours' normals from which on they lie on each other.
_FOLDED = -1.0 + 1e-9
# Sine of the angle between an edge and a plane up to which it lies in the plane.
_PARALLEL = 1e-9


@allocating_kernel
def first_crossing(vertices: FloatArray, triangles: IndexArray, max_pairs: int, slack: float = 0.0) -> tuple[int, int]:
    """Return two triangles of a surface that cross or lie on each other.

    Args:
        vertices: shape [v, 3].
        triangles: shape [f, 3].
        max_pairs: pairs with overlapping boxes that are looked at.
        slack: an edge that ends so close to another triangle's rim does not cross it, in the vertices' unit.

    Returns:
        Two triangles; NONE where there are none; TOO_MANY where there are more pairs than that.
    """
    low, high = _boxes(vertices, triangles)
    order = np.argsort(low[:, 0])
    pairs = 0
    for i in range(len(order)):
        a = order[i]
        for j in range(i + 1, len(order)):
            b = order[j]
            if low[b, 0] > high[a, 0]:
                break
            if low[b, 1] > high[a, 1] or low[a, 1] > high[b, 1] or low[b, 2] > high[a, 2] or low[a, 2] > high[b, 2]:
                continue
            pairs += 1
            if pairs > max_pairs:
                return TOO_MANY, TOO_MANY
            if _cross(vertices, triangles, a, b, slack):
                return min(a, b), max(a, b)
    return NONE, NONE


@allocating_kernel
def farthest(points: FloatArray, vertices: FloatArray, triangles: IndexArray) -> tuple[int, float]:
    """Return the point, of shape [n, 3], that is farthest from a surface, and its distance, in the points' unit."""
    low, high = _boxes(vertices, triangles)
    worst, at, nearest = 0.0, NONE, 0
    for i in range(len(points)):
        p = load(points, i)
        best = _squared_distance(p, vertices, triangles, nearest)
        for t in range(len(triangles)):
            if best <= worst:
                break
            if _squared_to_box(p, low, high, t) < best:
                squared = _squared_distance(p, vertices, triangles, t)
                if squared < best:
                    best, nearest = squared, t
        if best > worst:
            worst, at = best, i
    return at, np.sqrt(worst)


@allocating_kernel
def _boxes(vertices: FloatArray, triangles: IndexArray) -> tuple[FloatArray, FloatArray]:
    low, high = np.empty((len(triangles), 3)), np.empty((len(triangles), 3))
    for t in range(len(triangles)):
        for k in range(3):
            a, b, c = vertices[triangles[t, 0], k], vertices[triangles[t, 1], k], vertices[triangles[t, 2], k]
            low[t, k], high[t, k] = min(a, b, c), max(a, b, c)
    return low, high


@kernel
def _cross(vertices: FloatArray, triangles: IndexArray, a: int, b: int, slack: float) -> bool:
    shared, of_a, of_b = 0, 0, 0
    for i in range(3):
        for j in range(3):
            if triangles[a, i] == triangles[b, j]:
                shared += 1
                of_a, of_b = i, j
    if shared >= 2:
        return _folded(vertices, triangles, a, b)
    if shared == 1:
        return _edge_meets(vertices, triangles, a, (of_a + 1) % 3, b, slack) or _edge_meets(
            vertices, triangles, b, (of_b + 1) % 3, a, slack
        )
    meets = False
    for i in range(3):
        meets = meets or _edge_meets(vertices, triangles, a, i, b, slack)
        meets = meets or _edge_meets(vertices, triangles, b, i, a, slack)
    return meets


@kernel
def _edge_meets(vertices: FloatArray, triangles: IndexArray, a: int, i: int, b: int, slack: float) -> bool:
    """Return whether the edge of triangle a from its corner i on meets triangle b, be it only at its rim.

    Those of surfaces that were drawn on one grid cross exactly there. In one plane with it an edge does not meet it.
    """
    p, q = load(vertices, triangles[a, i]), load(vertices, triangles[a, (i + 1) % 3])
    along, normal = subtract(q, p), _normal(vertices, triangles, b)
    to_0 = subtract(load(vertices, triangles[b, 0]), p)
    to_1 = subtract(load(vertices, triangles[b, 1]), p)
    to_2 = subtract(load(vertices, triangles[b, 2]), p)
    height, rise = dot(to_0, normal), dot(along, normal)
    if abs(rise) <= _PARALLEL * np.sqrt(dot(along, along) * dot(normal, normal)) or height * (height - rise) > 0.0:
        return False
    u, v, w = dot(along, cross(to_2, to_1)), dot(along, cross(to_0, to_2)), dot(along, cross(to_1, to_0))
    inside = (u >= 0.0 and v >= 0.0 and w >= 0.0) or (u <= 0.0 and v <= 0.0 and w <= 0.0)
    if not inside or slack == 0.0 or min(abs(height), abs(height - rise)) > slack * np.sqrt(dot(normal, normal)):
        return inside
    return _depth(p, along, height / rise, vertices, triangles, b) > slack


@kernel
def _depth(p: Vec3, along: Vec3, part: float, vertices: FloatArray, triangles: IndexArray, b: int) -> float:
    """Return how far a part of the way from a point lies from the rim of the triangle that it is in."""
    depth = np.inf
    for i in range(3):
        corner = load(vertices, triangles[b, i])
        side = subtract(load(vertices, triangles[b, (i + 1) % 3]), corner)
        to = subtract(p, corner)
        at = (to[0] + part * along[0], to[1] + part * along[1], to[2] + part * along[2])
        across = cross(side, at)
        depth = min(depth, np.sqrt(dot(across, across) / dot(side, side)))
    return depth


@kernel
def _folded(vertices: FloatArray, triangles: IndexArray, a: int, b: int) -> bool:
    first, second = _normal(vertices, triangles, a), _normal(vertices, triangles, b)
    folded: bool = dot(first, second) < _FOLDED * np.sqrt(dot(first, first) * dot(second, second))
    return folded


@kernel
def _normal(vertices: FloatArray, triangles: IndexArray, t: int) -> Vec3:
    p = load(vertices, triangles[t, 0])
    return cross(subtract(load(vertices, triangles[t, 1]), p), subtract(load(vertices, triangles[t, 2]), p))


@kernel
def _squared_distance(p: Vec3, vertices: FloatArray, triangles: IndexArray, t: int) -> float:
    _, _, apart = closest_points(
        POINT_TRIANGLE,
        p,
        load(vertices, triangles[t, 0]),
        load(vertices, triangles[t, 1]),
        load(vertices, triangles[t, 2]),
    )
    return dot(apart, apart)


@kernel
def _squared_to_box(p: Vec3, low: FloatArray, high: FloatArray, t: int) -> float:
    squared = 0.0
    for k in range(3):
        outside = max(low[t, k] - p[k], p[k] - high[t, k], 0.0)
        squared += outside * outside
    return squared
