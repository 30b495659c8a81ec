"""Candidate pairs: every point-triangle and edge-edge pair of two bodies that can come within reach of each other.

The list is made with a margin and stays complete while bodies deform or move relative to each other by no more than
that; `relative_motion` bounds such motion, so that the caller knows when to make a new list. The distance at which a
pair was listed, less that motion, bounds its distance from below, so that most pairs need not be looked at again.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel, kernel
from ..algebra.vec3 import Vec3, add, dot, load, scale, subtract
from ..model.model import Surfaces
from .distance import EDGE_EDGE, POINT_TRIANGLE, closest_points

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
Corners = tuple[int, int, int, int]

_MOLLIFIER_THRESHOLD = 1e-3


class Candidates(NamedTuple):
    """Pairs that may be in contact; a list, not a set of contacts."""

    pair_type: IndexArray  # [k] POINT_TRIANGLE or EDGE_EDGE
    points: IndexArray  # [k, 4]
    friction: FloatArray  # [k]
    mollifier_eps_m4: FloatArray  # [k] 0 for point-triangle pairs
    distance_m: FloatArray  # [k] when the list was made
    bodies: IndexArray  # [k] row of `Surfaces.pairs`


class Search(NamedTuple):
    """What is searched for pairs."""

    surfaces: Surfaces
    y: FloatArray  # [p, 3] points [m]
    reach_m: float  # of the pair of bodies looked at


@allocating_kernel
def find_candidates(surfaces: Surfaces, y: FloatArray, reach_m: FloatArray) -> Candidates:
    """Return all pairs within the reach [m], shape [k], of their pair of bodies, at points y [m] of shape [p, 3]."""
    capacity = 4096
    while True:
        found = Candidates(
            np.empty(capacity, np.int64),
            np.empty((capacity, 4), np.int64),
            np.empty(capacity),
            np.zeros(capacity),
            np.empty(capacity),
            np.empty(capacity, np.int64),
        )
        count = 0
        for k in range(len(surfaces.pairs)):
            a, b = surfaces.pairs[k, 0], surfaces.pairs[k, 1]
            first = count
            search = Search(surfaces, y, reach_m[k])
            count = _point_triangle_pairs(search, a, b, found, count)
            count = _point_triangle_pairs(search, b, a, found, count)
            count = _edge_edge_pairs(search, a, b, found, count)
            found.friction[first : min(count, capacity)] = surfaces.pair_friction[k]
            found.bodies[first : min(count, capacity)] = k
        if count <= capacity:
            return Candidates(
                found.pair_type[:count],
                found.points[:count],
                found.friction[:count],
                found.mollifier_eps_m4[:count],
                found.distance_m[:count],
                found.bodies[:count],
            )
        capacity = count


@allocating_kernel
def _point_triangle_pairs(search: Search, a: int, b: int, found: Candidates, count: int) -> int:
    """Append the pairs of points of body a and triangles of body b."""
    triangles, starts, y = search.surfaces.triangles, search.surfaces.triangle_start, search.y
    near_points = _near_points(search, a, b)
    near_triangles = near_rows(search, triangles, starts[b], starts[b + 1], a)
    boxes = _boxes(triangles, near_triangles, y, search.reach_m)
    for p in near_points:
        x = load(y, p)
        for i in range(len(near_triangles)):
            if _boxes_meet(x, x, _low(boxes, i), _high(boxes, i)):
                t = near_triangles[i]
                corners = (p, triangles[t, 0], triangles[t, 1], triangles[t, 2])
                count = _append(search, found, count, POINT_TRIANGLE, corners, 0.0)
    return count


@allocating_kernel
def _edge_edge_pairs(search: Search, a: int, b: int, found: Candidates, count: int) -> int:
    """Append the pairs of edges of body a and of body b."""
    edges, starts = search.surfaces.edges, search.surfaces.edge_start
    lengths, y = search.surfaces.edge_squared_length_m2, search.y
    of_a = near_rows(search, edges, starts[a], starts[a + 1], b)
    of_b = near_rows(search, edges, starts[b], starts[b + 1], a)
    box_a = _boxes(edges, of_a, y, search.reach_m)
    box_b = _boxes(edges, of_b, y, 0.0)
    for i in range(len(of_a)):
        for j in range(len(of_b)):
            if _boxes_meet(_low(box_a, i), _high(box_a, i), _low(box_b, j), _high(box_b, j)):
                e, f = of_a[i], of_b[j]
                corners = (edges[e, 0], edges[e, 1], edges[f, 0], edges[f, 1])
                eps = _MOLLIFIER_THRESHOLD * lengths[e] * lengths[f]
                count = _append(search, found, count, EDGE_EDGE, corners, eps)
    return count


@kernel
def _append(search: Search, found: Candidates, count: int, pair_type: int, corners: Corners, eps: float) -> int:
    """Append a pair if it is within reach; beyond the capacity pairs are only counted."""
    y = search.y
    _, _, r = closest_points(
        pair_type, load(y, corners[0]), load(y, corners[1]), load(y, corners[2]), load(y, corners[3])
    )
    distance = _length(r)
    if distance > search.reach_m:
        return count
    if count < len(found.pair_type):
        points = found.points
        found.pair_type[count] = pair_type
        points[count, 0], points[count, 1], points[count, 2], points[count, 3] = corners
        found.mollifier_eps_m4[count] = eps
        found.distance_m[count] = distance
    return count + 1


@kernel
def _boxes_meet(low_a: Vec3, high_a: Vec3, low_b: Vec3, high_b: Vec3) -> bool:
    return (
        low_a[0] <= high_b[0]
        and low_b[0] <= high_a[0]
        and low_a[1] <= high_b[1]
        and low_b[1] <= high_a[1]
        and low_a[2] <= high_b[2]
        and low_b[2] <= high_a[2]
    )


@kernel
def _low(boxes: FloatArray, i: int) -> Vec3:
    return boxes[i, 0], boxes[i, 1], boxes[i, 2]


@kernel
def _high(boxes: FloatArray, i: int) -> Vec3:
    return boxes[i, 3], boxes[i, 4], boxes[i, 5]


@kernel
def _body_box(search: Search, body: int) -> tuple[Vec3, Vec3]:
    """Return the corners of a body's bounding box, grown by the reach."""
    start, y, reach = search.surfaces.point_start, search.y, search.reach_m
    low = load(y, start[body])
    high = low
    for p in range(start[body] + 1, start[body + 1]):
        x = load(y, p)
        low = (min(low[0], x[0]), min(low[1], x[1]), min(low[2], x[2]))
        high = (max(high[0], x[0]), max(high[1], x[1]), max(high[2], x[2]))
    return (low[0] - reach, low[1] - reach, low[2] - reach), (
        high[0] + reach,
        high[1] + reach,
        high[2] + reach,
    )


@allocating_kernel
def _near_points(search: Search, a: int, b: int) -> IndexArray:
    """Return the points of body a within reach of the box of body b."""
    low, high = _body_box(search, b)
    first, last = search.surfaces.point_start[a], search.surfaces.point_start[a + 1]
    found = np.empty(last - first, np.int64)
    count = 0
    for p in range(first, last):
        x = load(search.y, p)
        if _boxes_meet(x, x, low, high):
            found[count] = p
            count += 1
    return found[:count]


@allocating_kernel
def near_rows(search: Search, rows: IndexArray, start: int, stop: int, other: int) -> IndexArray:
    """Return the rows (edges or triangles) start..stop whose box is within reach of the box of body `other`."""
    low, high = _body_box(search, other)
    found = np.empty(stop - start, np.int64)
    count = 0
    for row in range(start, stop):
        box_low, box_high = _row_box(rows, row, search.y)
        if _boxes_meet(box_low, box_high, low, high):
            found[count] = row
            count += 1
    return found[:count]


@kernel
def _row_box(rows: IndexArray, row: int, y: FloatArray) -> tuple[Vec3, Vec3]:
    low = load(y, rows[row, 0])
    high = low
    for k in range(1, rows.shape[1]):
        x = load(y, rows[row, k])
        low = (min(low[0], x[0]), min(low[1], x[1]), min(low[2], x[2]))
        high = (max(high[0], x[0]), max(high[1], x[1]), max(high[2], x[2]))
    return low, high


@allocating_kernel
def _boxes(rows: IndexArray, selected: IndexArray, y: FloatArray, reach: float) -> FloatArray:
    """Return the bounding boxes [low, high] of the selected rows, grown by reach, shape [n, 6]."""
    boxes = np.empty((len(selected), 6))
    for i in range(len(selected)):
        low, high = _row_box(rows, selected[i], y)
        for k in range(3):
            boxes[i, k] = low[k] - reach
            boxes[i, 3 + k] = high[k] + reach
    return boxes


@allocating_kernel
def relative_motion(surfaces: Surfaces, displacement: FloatArray, motion: FloatArray) -> float:
    """Return the largest possible change of a separation [m] under a point displacement [m] of shape [p, 3].

    Written to `motion` [k] for each pair of bodies; the largest of them is returned. A body moves by its mean
    displacement and, relative to it, by at most its spread; a common translation of two bodies changes nothing.
    """
    bodies = len(surfaces.point_start) - 1
    mean, spread = np.empty((bodies, 3)), np.zeros(bodies)
    starts, pairs = surfaces.point_start, surfaces.pairs
    for body in range(bodies):
        first, last = starts[body], starts[body + 1]
        total = (0.0, 0.0, 0.0)
        for p in range(first, last):
            total = add(total, load(displacement, p))
        centre = scale(1.0 / (last - first), total)
        mean[body, 0], mean[body, 1], mean[body, 2] = centre
        for p in range(first, last):
            away = subtract(load(displacement, p), centre)
            spread[body] = max(spread[body], dot(away, away))
        spread[body] = np.sqrt(spread[body])
    largest = 0.0
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        motion[k] = _length(subtract(load(mean, a), load(mean, b))) + spread[a] + spread[b]
        largest = max(largest, motion[k])
    return largest


@kernel
def _length(v: Vec3) -> float:
    return float(np.sqrt(dot(v, v)))
