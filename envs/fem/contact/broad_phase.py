"""Candidate pairs: every point-triangle and edge-edge pair of two bodies that can come within reach of each other.

The list is made with a margin and stays complete while bodies deform or move relative to each other by no more than
that; `relative_motion` bounds such motion, so that the caller knows when to make a new list. The distance at which a
pair was listed, less that motion, bounds its distance from below, so that most pairs need not be looked at again.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel, kernel, large_kernel
from ..algebra import Vec3, add, dot, load, scale, subtract
from ..model.model import Surfaces
from .distance import EDGE_EDGE, POINT_TRIANGLE, closest_points

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
Corners = tuple[int, int, int, int]

_MOLLIFIER_THRESHOLD = 1e-3
NO_TRIANGLE = -1


class Candidates(NamedTuple):
    """Pairs that may be in contact; a list, not a set of contacts."""

    pair_type: IndexArray  # [k] POINT_TRIANGLE or EDGE_EDGE
    points: IndexArray  # [k, 4]
    triangle: IndexArray  # [k] that of a point-triangle pair, or NO_TRIANGLE
    friction: FloatArray  # [k]
    mollifier_eps_m4: FloatArray  # [k] 0 for point-triangle pairs
    distance_m: FloatArray  # [k] when the list was made
    bodies: IndexArray  # [k] row of `Surfaces.pairs`
    dual: FloatArray  # [k, 6] slip [m] and dual variable of friction at the last matrix; nan where there was none


class Search(NamedTuple):
    """What is searched for pairs."""

    surfaces: Surfaces
    y: FloatArray  # [p, 3] points [m]
    body_boxes: FloatArray  # [b, 6] lowest and highest coordinates of each body [m]
    reach_m: float  # of the pair of bodies looked at


class NearRows(NamedTuple):
    """Room for points, edges or triangles of a body that are near another one, and for their bounding boxes."""

    rows: IndexArray  # [n]
    boxes: FloatArray  # [n, 6] lowest and highest coordinates [m]


class Room(NamedTuple):
    """Room for what is near of the first and of the second body of a pair."""

    first: NearRows
    second: NearRows


@allocating_kernel
def find_candidates(surfaces: Surfaces, y: FloatArray, reach_m: FloatArray) -> Candidates:
    """Return all pairs within the reach [m], shape [k], of their pair of bodies, at points y [m] of shape [p, 3].

    Everything is allocated here: counting references to a search's many arrays takes longer than many a search.
    """
    rows = max(len(y), len(surfaces.edges), len(surfaces.triangles))
    room = Room(
        NearRows(np.empty(rows, np.int64), np.empty((rows, 6))), NearRows(np.empty(rows, np.int64), np.empty((rows, 6)))
    )
    body_boxes = find_body_boxes(surfaces, y)
    capacity = 1024
    while True:
        found = Candidates(
            np.empty(capacity, np.int64),
            np.empty((capacity, 4), np.int64),
            np.empty(capacity, np.int64),
            np.empty(capacity),
            np.zeros(capacity),
            np.empty(capacity),
            np.empty(capacity, np.int64),
            np.empty((0, 6)),
        )
        count = 0
        for k in range(len(surfaces.pairs)):
            search = Search(surfaces, y, body_boxes, reach_m[k])
            count = _append_pairs(search, k, room, found, count)
        if count <= capacity:
            return Candidates(
                found.pair_type[:count],
                found.points[:count],
                found.triangle[:count],
                found.friction[:count],
                found.mollifier_eps_m4[:count],
                found.distance_m[:count],
                found.bodies[:count],
                np.full((count, 6), np.nan),
            )
        capacity = count


@large_kernel
def _append_pairs(search: Search, k: int, room: Room, found: Candidates, count: int) -> int:
    """Append the pairs of the k-th pair of bodies."""
    surfaces = search.surfaces
    a, b = surfaces.pairs[k, 0], surfaces.pairs[k, 1]
    first = count
    count = _point_triangle_pairs(search, a, b, room, found, count)
    count = _point_triangle_pairs(search, b, a, room, found, count)
    count = _edge_edge_pairs(search, a, b, room, found, count)
    for i in range(first, min(count, len(found.bodies))):
        found.friction[i] = surfaces.pair_friction[k]
        found.bodies[i] = k
    return count


@large_kernel
def _point_triangle_pairs(search: Search, a: int, b: int, room: Room, found: Candidates, count: int) -> int:
    """Append the pairs of points of body a and triangles of body b."""
    triangles, starts, y = search.surfaces.triangles, search.surfaces.triangle_start, search.y
    points, near, boxes = room.first.rows, room.second.rows, room.second.boxes
    point_count = _write_near_points(search, a, b, points)
    near_count = write_near_rows(search, triangles, (starts[b], starts[b + 1]), a, near)
    _write_boxes(triangles, room.second, near_count, y, search.reach_m)
    for k in range(point_count):
        p = points[k]
        x = load(y, p)
        for i in range(near_count):
            if _boxes_meet(x, x, _low(boxes, i), _high(boxes, i)):
                t = near[i]
                corners = (p, triangles[t, 0], triangles[t, 1], triangles[t, 2])
                count = _append(search, found, count, t, corners, 0.0)
    return count


@large_kernel
def _edge_edge_pairs(search: Search, a: int, b: int, room: Room, found: Candidates, count: int) -> int:
    """Append the pairs of edges of body a and of body b."""
    edges, starts = search.surfaces.edges, search.surfaces.edge_start
    lengths, y = search.surfaces.edge_squared_length_m2, search.y
    of_a, of_b, box_a, box_b = room.first.rows, room.second.rows, room.first.boxes, room.second.boxes
    count_a = write_near_rows(search, edges, (starts[a], starts[a + 1]), b, of_a)
    count_b = write_near_rows(search, edges, (starts[b], starts[b + 1]), a, of_b)
    _write_boxes(edges, room.first, count_a, y, search.reach_m)
    _write_boxes(edges, room.second, count_b, y, 0.0)
    for i in range(count_a):
        for j in range(count_b):
            if _boxes_meet(_low(box_a, i), _high(box_a, i), _low(box_b, j), _high(box_b, j)):
                e, f = of_a[i], of_b[j]
                corners = (edges[e, 0], edges[e, 1], edges[f, 0], edges[f, 1])
                eps = _MOLLIFIER_THRESHOLD * lengths[e] * lengths[f]
                count = _append(search, found, count, NO_TRIANGLE, corners, eps)
    return count


@kernel
def _append(search: Search, found: Candidates, count: int, triangle: int, corners: Corners, eps: float) -> int:
    """Append a pair if it is within reach; beyond the capacity pairs are only counted."""
    y, pair_type = search.y, EDGE_EDGE if triangle == NO_TRIANGLE else POINT_TRIANGLE
    _, _, r = closest_points(
        pair_type, load(y, corners[0]), load(y, corners[1]), load(y, corners[2]), load(y, corners[3])
    )
    distance = _length(r)
    if distance > search.reach_m:
        return count
    if count < len(found.pair_type):
        points = found.points
        found.pair_type[count], found.triangle[count] = pair_type, triangle
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


@allocating_kernel
def find_body_boxes(surfaces: Surfaces, y: FloatArray) -> FloatArray:
    """Return the lowest and the highest coordinates of the points of each body [m], shape [b, 6]."""
    start = surfaces.point_start
    boxes = np.empty((len(start) - 1, 6))
    for body in range(len(boxes)):
        low = load(y, start[body])
        high = low
        for p in range(start[body] + 1, start[body + 1]):
            x = load(y, p)
            low = (min(low[0], x[0]), min(low[1], x[1]), min(low[2], x[2]))
            high = (max(high[0], x[0]), max(high[1], x[1]), max(high[2], x[2]))
        boxes[body, 0], boxes[body, 1], boxes[body, 2] = low
        boxes[body, 3], boxes[body, 4], boxes[body, 5] = high
    return boxes


@kernel
def _body_box(search: Search, body: int) -> tuple[Vec3, Vec3]:
    """Return the corners of a body's bounding box, grown by the reach."""
    boxes, reach = search.body_boxes, search.reach_m
    low, high = _low(boxes, body), _high(boxes, body)
    return (low[0] - reach, low[1] - reach, low[2] - reach), (high[0] + reach, high[1] + reach, high[2] + reach)


@kernel
def _write_near_points(search: Search, a: int, b: int, found: IndexArray) -> int:
    """Write the vertices of body a within reach of the box of body b; return their number."""
    low, high = _body_box(search, b)
    count = 0
    vertices, starts = search.surfaces.vertices, search.surfaces.vertex_start
    for k in range(starts[a], starts[a + 1]):
        x = load(search.y, vertices[k])
        if _boxes_meet(x, x, low, high):
            found[count] = vertices[k]
            count += 1
    return count


@kernel
def write_near_rows(search: Search, rows: IndexArray, span: tuple[int, int], other: int, found: IndexArray) -> int:
    """Write which rows (edges or triangles) of a span come within reach of the box of body `other`; return how many."""
    low, high = _body_box(search, other)
    count = 0
    for row in range(span[0], span[1]):
        box_low, box_high = _row_box(rows, row, search.y)
        if _boxes_meet(box_low, box_high, low, high):
            found[count] = row
            count += 1
    return count


@kernel
def _row_box(rows: IndexArray, row: int, y: FloatArray) -> tuple[Vec3, Vec3]:
    low = load(y, rows[row, 0])
    high = low
    for k in range(1, rows.shape[1]):
        x = load(y, rows[row, k])
        low = (min(low[0], x[0]), min(low[1], x[1]), min(low[2], x[2]))
        high = (max(high[0], x[0]), max(high[1], x[1]), max(high[2], x[2]))
    return low, high


@kernel
def _write_boxes(rows: IndexArray, near: NearRows, count: int, y: FloatArray, reach: float) -> None:
    """Write the bounding boxes of the first rows of what is near, grown by the reach."""
    for i in range(count):
        low, high = _row_box(rows, near.rows[i], y)
        for k in range(3):
            near.boxes[i, k] = low[k] - reach
            near.boxes[i, 3 + k] = high[k] + reach


@large_kernel
def relative_motion(surfaces: Surfaces, displacement: FloatArray, body_motion: FloatArray, motion: FloatArray) -> float:
    """Return the largest possible change of a separation [m] under a point displacement [m] of shape [p, 3].

    Written to `motion` [k] for each pair of bodies; the largest of them is returned. A body moves by its mean
    displacement and, relative to it, by at most its spread, both written to `body_motion` [b, 4]; a common translation
    of two bodies changes nothing.
    """
    starts, pairs = surfaces.point_start, surfaces.pairs
    for body in range(len(body_motion)):
        first, last = starts[body], starts[body + 1]
        total = (0.0, 0.0, 0.0)
        for p in range(first, last):
            total = add(total, load(displacement, p))
        centre = scale(1.0 / (last - first), total)
        spread = 0.0
        for p in range(first, last):
            away = subtract(load(displacement, p), centre)
            spread = max(spread, dot(away, away))
        body_motion[body, 0], body_motion[body, 1], body_motion[body, 2] = centre
        body_motion[body, 3] = np.sqrt(spread)
    largest = 0.0
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        apart = _length(subtract(load(body_motion, a), load(body_motion, b)))
        motion[k] = apart + body_motion[a, 3] + body_motion[b, 3]
        largest = max(largest, motion[k])
    return largest


@kernel
def _length(v: Vec3) -> float:
    return float(np.sqrt(dot(v, v)))
