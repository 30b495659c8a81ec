"""Candidate pairs: every point-triangle and edge-edge pair of two bodies that can come within reach of each other.

The list is made with a margin and stays complete while bodies deform or move relative to each other by no more than
that; `relative_motion` bounds such motion, so that the caller knows when to make a new list.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from .distance import EDGE_EDGE, POINT_TRIANGLE
from .model import Surfaces
from .vec3 import Vec3, dot, load, subtract

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_MOLLIFIER_THRESHOLD = 1e-3


class Candidates(NamedTuple):
    """Pairs that may be in contact; a list, not a set of contacts."""

    kind: IndexArray  # [k] POINT_TRIANGLE or EDGE_EDGE
    points: IndexArray  # [k, 4]
    friction: FloatArray  # [k]
    mollifier_eps_m4: FloatArray  # [k] 0 for point-triangle pairs


@kernel
def find_candidates(surfaces: Surfaces, y: FloatArray, reach_m: float) -> Candidates:
    """All pairs whose bounding boxes are within reach_m [m] of each other, at points y [m] of shape [p, 3]."""
    capacity = 4096
    while True:
        kind = np.empty(capacity, np.int64)
        points = np.empty((capacity, 4), np.int64)
        friction = np.empty(capacity)
        eps = np.empty(capacity)
        count = 0
        for k in range(len(surfaces.pairs)):
            a, b = surfaces.pairs[k, 0], surfaces.pairs[k, 1]
            first = count
            count = _point_triangle_pairs(surfaces, y, reach_m, a, b, kind, points, count)
            count = _point_triangle_pairs(surfaces, y, reach_m, b, a, kind, points, count)
            count = _edge_edge_pairs(surfaces, y, reach_m, a, b, kind, points, eps, count)
            friction[first : min(count, capacity)] = surfaces.pair_friction[k]
        if count <= capacity:
            return Candidates(kind[:count], points[:count], friction[:count], eps[:count])
        capacity = count


@kernel
def _point_triangle_pairs(
    surfaces: Surfaces,
    y: FloatArray,
    reach: float,
    a: int,
    b: int,
    kind: IndexArray,
    points: IndexArray,
    count: int,
) -> int:
    """Append the pairs of points of body a and triangles of body b."""
    near_points = _near_points(surfaces, y, reach, a, b)
    near_triangles = near_rows(
        surfaces.triangles,
        surfaces.triangle_start[b],
        surfaces.triangle_start[b + 1],
        y,
        reach,
        surfaces,
        a,
    )
    boxes = _boxes(surfaces.triangles, near_triangles, y, reach)
    for p in near_points:
        x = load(y, p)
        for i in range(len(near_triangles)):
            if (
                boxes[i, 0] <= x[0] <= boxes[i, 3]
                and boxes[i, 1] <= x[1] <= boxes[i, 4]
                and boxes[i, 2] <= x[2] <= boxes[i, 5]
            ):
                if count < len(kind):
                    kind[count] = POINT_TRIANGLE
                    points[count, 0] = p
                    points[count, 1:] = surfaces.triangles[near_triangles[i]]
                count += 1
    return count


@kernel
def _edge_edge_pairs(
    surfaces: Surfaces,
    y: FloatArray,
    reach: float,
    a: int,
    b: int,
    kind: IndexArray,
    points: IndexArray,
    eps: FloatArray,
    count: int,
) -> int:
    """Append the pairs of edges of body a and of body b."""
    of_a = near_rows(
        surfaces.edges,
        surfaces.edge_start[a],
        surfaces.edge_start[a + 1],
        y,
        reach,
        surfaces,
        b,
    )
    of_b = near_rows(
        surfaces.edges,
        surfaces.edge_start[b],
        surfaces.edge_start[b + 1],
        y,
        reach,
        surfaces,
        a,
    )
    box_a = _boxes(surfaces.edges, of_a, y, reach)
    box_b = _boxes(surfaces.edges, of_b, y, 0.0)
    for i in range(len(of_a)):
        for j in range(len(of_b)):
            if (
                box_a[i, 0] <= box_b[j, 3]
                and box_b[j, 0] <= box_a[i, 3]
                and box_a[i, 1] <= box_b[j, 4]
                and box_b[j, 1] <= box_a[i, 4]
                and box_a[i, 2] <= box_b[j, 5]
                and box_b[j, 2] <= box_a[i, 5]
            ):
                if count < len(kind):
                    kind[count] = EDGE_EDGE
                    points[count, :2] = surfaces.edges[of_a[i]]
                    points[count, 2:] = surfaces.edges[of_b[j]]
                    eps[count] = (
                        _MOLLIFIER_THRESHOLD
                        * surfaces.edge_squared_length_m2[of_a[i]]
                        * surfaces.edge_squared_length_m2[of_b[j]]
                    )
                count += 1
    return count


@kernel
def _body_box(surfaces: Surfaces, y: FloatArray, reach: float, body: int) -> tuple[Vec3, Vec3]:
    """Corners of a body's bounding box, grown by reach."""
    low = load(y, surfaces.point_start[body])
    high = low
    for p in range(surfaces.point_start[body] + 1, surfaces.point_start[body + 1]):
        x = load(y, p)
        low = (min(low[0], x[0]), min(low[1], x[1]), min(low[2], x[2]))
        high = (max(high[0], x[0]), max(high[1], x[1]), max(high[2], x[2]))
    return (low[0] - reach, low[1] - reach, low[2] - reach), (
        high[0] + reach,
        high[1] + reach,
        high[2] + reach,
    )


@kernel
def _near_points(surfaces: Surfaces, y: FloatArray, reach: float, a: int, b: int) -> IndexArray:
    """Points of body a within reach of the box of body b."""
    low, high = _body_box(surfaces, y, reach, b)
    found = np.empty(surfaces.point_start[a + 1] - surfaces.point_start[a], np.int64)
    count = 0
    for p in range(surfaces.point_start[a], surfaces.point_start[a + 1]):
        x = load(y, p)
        if low[0] <= x[0] <= high[0] and low[1] <= x[1] <= high[1] and low[2] <= x[2] <= high[2]:
            found[count] = p
            count += 1
    return found[:count]


@kernel
def near_rows(
    rows: IndexArray,
    start: int,
    stop: int,
    y: FloatArray,
    reach: float,
    surfaces: Surfaces,
    other: int,
) -> IndexArray:
    """Rows (edges or triangles) start..stop whose box is within reach of the box of body `other`."""
    low, high = _body_box(surfaces, y, reach, other)
    found = np.empty(stop - start, np.int64)
    count = 0
    for row in range(start, stop):
        box_low, box_high = _row_box(rows, row, y)
        if (
            box_low[0] <= high[0]
            and low[0] <= box_high[0]
            and box_low[1] <= high[1]
            and low[1] <= box_high[1]
            and box_low[2] <= high[2]
            and low[2] <= box_high[2]
        ):
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


@kernel
def _boxes(rows: IndexArray, selected: IndexArray, y: FloatArray, reach: float) -> FloatArray:
    """Bounding boxes [low, high] of the selected rows, grown by reach, shape [n, 6]."""
    boxes = np.empty((len(selected), 6))
    for i in range(len(selected)):
        low, high = _row_box(rows, selected[i], y)
        for k in range(3):
            boxes[i, k] = low[k] - reach
            boxes[i, 3 + k] = high[k] + reach
    return boxes


@kernel
def relative_motion(surfaces: Surfaces, displacement: FloatArray, mean: FloatArray, spread: FloatArray) -> float:
    """Largest possible change of any pair's separation [m] under a point displacement [m] of shape [p, 3].

    A body moves by its mean displacement and, relative to it, by at most its spread; a common translation of two
    bodies changes nothing. `mean` [b, 3] and `spread` [b] are scratch.
    """
    for body in range(len(spread)):
        first, last = surfaces.point_start[body], surfaces.point_start[body + 1]
        for k in range(3):
            total = 0.0
            for p in range(first, last):
                total += displacement[p, k]
            mean[body, k] = total / (last - first)
        spread[body] = 0.0
        centre = load(mean, body)
        for p in range(first, last):
            spread[body] = max(spread[body], _length(subtract(load(displacement, p), centre)))
    largest = 0.0
    for k in range(len(surfaces.pairs)):
        a, b = surfaces.pairs[k, 0], surfaces.pairs[k, 1]
        apart = _length(subtract(load(mean, a), load(mean, b)))
        largest = max(largest, apart + spread[a] + spread[b])
    return largest


@kernel
def _length(v: Vec3) -> float:
    return float(np.sqrt(dot(v, v)))
