"""Plane polygons: offset, rotation and exact-predicate tests. Used by the solids and by the blocked-start test."""

import numpy as np
from numpy.typing import NDArray

# Corners of a simple polygon, counter-clockwise, shape [n, 2].
Polygon = NDArray[np.float64]
Point = NDArray[np.float64]


def as_polygon(corners: list[tuple[float, float]]) -> Polygon:
    """Return the corner list as an array of shape [n, 2]."""
    return np.array(corners, dtype=np.float64)


def mitred_offset(polygon: Polygon, distance: float) -> Polygon:
    """Return the counter-clockwise polygon with every edge moved out by `distance`, its ends to the mitre joints."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.sqrt(edges[:, 0] * edges[:, 0] + edges[:, 1] * edges[:, 1])
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / lengths[:, None]
    before = np.roll(normals, 1, axis=0)
    # The corner moves along the bisector n1 + n2, by d / (1 + n1.n2) so that both edges move by d.
    stretch = distance / (1.0 + (before * normals).sum(axis=1))
    return np.asarray(polygon + stretch[:, None] * (before + normals))


def orientation(a: Point, b: Point, c: Point) -> float:
    """Return twice the signed area of the triangle abc: positive for a left turn, 0 for collinear points."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def segments_touch(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Return whether the closed segments ab and cd have a point in common."""
    abc, abd = orientation(a, b, c), orientation(a, b, d)
    cda, cdb = orientation(c, d, a), orientation(c, d, b)
    if abc * abd < 0 and cda * cdb < 0:
        return True
    return (
        (abc == 0 and _within_box(a, b, c))
        or (abd == 0 and _within_box(a, b, d))
        or (cda == 0 and _within_box(c, d, a))
        or (cdb == 0 and _within_box(c, d, b))
    )


def boundaries_touch(first: Polygon, second: Polygon) -> bool:
    """Return whether the outlines of two polygons have a point in common."""
    return any(
        segments_touch(first[i - 1], first[i], second[j - 1], second[j])
        for i in range(len(first))
        for j in range(len(second))
    )


def contains(polygon: Polygon, point: Point) -> bool:
    """Return whether a point lies strictly inside a polygon; unspecified on the outline (crossing number)."""
    inside = False
    for i in range(len(polygon)):
        a, b = polygon[i - 1], polygon[i]
        if (a[1] > point[1]) != (b[1] > point[1]):
            upward = b[1] > a[1]
            inside ^= (orientation(a, b, point) > 0) == upward
    return inside


def overlaps_plate(polygon: Polygon, *, plate: Polygon, hole: Polygon) -> bool:
    """Return whether a polygon meets the material between a plate's outline and its hole (touching counts).

    If no outlines touch, the polygon lies wholly in the hole, wholly outside the plate, wholly in the material, or
    around the hole; one corner of each decides.
    """
    if boundaries_touch(polygon, hole) or boundaries_touch(polygon, plate):
        return True
    in_material = contains(plate, polygon[0]) and not contains(hole, polygon[0])
    return in_material or contains(polygon, hole[0])


def _within_box(a: Point, b: Point, point: Point) -> bool:
    return bool(min(a[0], b[0]) <= point[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= point[1] <= max(a[1], b[1]))
