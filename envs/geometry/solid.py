"""Closed solids of plane faces: polygons, their triangles by ear clipping, and prisms."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np
from numpy.typing import NDArray

from ..fem.model.mesh import SurfaceMesh

# Corners of a simple polygon, counter-clockwise, shape [n, 2].
Polygon = NDArray[np.float64]
Point = NDArray[np.float64]


def as_polygon(corners: list[tuple[float, float]]) -> Polygon:
    """Return the corner list as an array of shape [n, 2]."""
    return np.array(corners, dtype=np.float64)


def mitred_offset(polygon: Polygon, distance: float) -> Polygon:
    """Return the counter-clockwise polygon with every edge moved out by `distance`, its ends to the mitre joints."""
    before, normals = _edge_normals(polygon)
    # The corner moves along the bisector n1 + n2, by d / (1 + n1.n2) so that both edges move by d.
    stretch = distance / (1.0 + (before * normals).sum(axis=1))
    return np.asarray(polygon + stretch[:, None] * (before + normals))


def offset_edges(polygon: Polygon, distances: NDArray[np.float64]) -> Polygon:
    """Return the counter-clockwise polygon with every edge moved out by a distance of its own.

    Args:
        polygon: corners, shape [n, 2]; no two neighbouring edges are parallel.
        distances: of the edge that begins at each corner, shape [n].
    """
    before, normals = _edge_normals(polygon)
    cosine = (before * normals).sum(axis=1)
    first, second = np.roll(distances, 1), distances
    # The corner moves by a n1 + b n2, which is d1 along n1 and d2 along n2.
    a, b = ((one - other * cosine) / (1.0 - cosine * cosine) for one, other in ((first, second), (second, first)))
    return np.asarray(polygon + a[:, None] * before + b[:, None] * normals)


def _edge_normals(polygon: Polygon) -> tuple[Polygon, Polygon]:
    """Return the outward normals of the edges that end and that begin at each corner, shapes [n, 2]."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.sqrt(edges[:, 0] * edges[:, 0] + edges[:, 1] * edges[:, 1])
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / lengths[:, None]
    return np.roll(normals, 1, axis=0), normals


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


MILLIMETRE_M = 1e-3
# Coordinate axes in the plane of a prism's profile, and the direction in which it is extruded; each is right-handed.
XY_ALONG_Z = (0, 1, 2)
ZX_ALONG_Y = (2, 0, 1)


@dataclass(frozen=True, kw_only=True)
class Face:
    """Flat face of a solid.

    Attributes:
        outline_mm: corners counter-clockwise seen from outside the solid [mm], shape [n, 3].
        holes_mm: outlines of openings in the face [mm].
    """

    outline_mm: NDArray[np.float64]
    holes_mm: tuple[NDArray[np.float64], ...] = ()


def solid_from_faces(faces: Iterable[Face], name: str) -> SurfaceMesh:
    """Return the surface of the solid that the faces enclose; corners at the same position become one vertex [m]."""
    vertices: dict[tuple[float, ...], int] = {}
    triangles = []
    for face in faces:
        corners = np.concatenate([face.outline_mm, *face.holes_mm])
        numbers = [vertices.setdefault(tuple(corner.tolist()), len(vertices)) for corner in corners]
        triangles += [[numbers[i] for i in triangle] for triangle in _triangulated(face)]
    positions_m = np.array(list(vertices), dtype=np.float64) * MILLIMETRE_M
    return SurfaceMesh(vertices_m=positions_m, triangles=np.array(triangles, dtype=np.int64), name=name)


def prism_faces(
    profile_mm: Polygon,
    low_mm: float,
    high_mm: float,
    *,
    axes: tuple[int, int, int] = XY_ALONG_Z,
    holes_mm: tuple[Polygon, ...] = (),
) -> list[Face]:
    """Return the faces of a prism: two end caps, and one wall for every edge of the profile and of its through holes.

    Args:
        profile_mm: counter-clockwise outline [mm], shape [n, 2], in the plane of `axes[0]`, `axes[1]`.
        low_mm: start of the extrusion along `axes[2]` [mm].
        high_mm: end of the extrusion [mm].
        axes: a cyclic permutation of (0, 1, 2).
        holes_mm: counter-clockwise outlines of through holes [mm].
    """

    def placed(polygon: Polygon, height: float) -> NDArray[np.float64]:
        corners = np.empty((len(polygon), 3))
        corners[:, axes[0]], corners[:, axes[1]], corners[:, axes[2]] = polygon[:, 0], polygon[:, 1], height
        return corners

    def walls(polygon: Polygon) -> list[Face]:
        return walls_between(placed(polygon, low_mm), placed(polygon, high_mm))

    bottom = Face(
        outline_mm=placed(profile_mm[::-1], low_mm), holes_mm=tuple(placed(hole, low_mm) for hole in holes_mm)
    )
    top = Face(outline_mm=placed(profile_mm, high_mm), holes_mm=tuple(placed(hole, high_mm) for hole in holes_mm))
    hole_walls = [wall for hole in holes_mm for wall in walls(hole[::-1])]
    return [bottom, top, *walls(profile_mm), *hole_walls]


def walls_between(low_mm: NDArray[np.float64], high_mm: NDArray[np.float64]) -> list[Face]:
    """Return a face for each pair of corners of two outlines in space, counter-clockwise [mm], shapes [n, 3]."""
    return [
        Face(outline_mm=np.array([low_mm[i - 1], low_mm[i], high_mm[i], high_mm[i - 1]])) for i in range(len(low_mm))
    ]


def at_height(polygon: Polygon, z_mm: float) -> NDArray[np.float64]:
    """Return the corners of a polygon at a height [mm], shape [n, 3]."""
    return np.column_stack([polygon, np.full(len(polygon), z_mm)])


def rectangle(x_low: float, x_high: float, y_low: float, y_high: float) -> Polygon:
    """Return the counter-clockwise rectangle, shape [4, 2]."""
    return np.array([[x_low, y_low], [x_high, y_low], [x_high, y_high], [x_low, y_high]], dtype=np.float64)


def nearest_vertices(surface: SurfaceMesh, points_m: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the vertex of a surface nearest to each of the points [m], shape [n, 3] to [n]."""
    apart = surface.vertices_m[None, :, :] - points_m[:, None, :]
    return np.asarray((apart * apart).sum(axis=2).argmin(axis=1), dtype=np.int64)


def _triangulated(face: Face) -> list[tuple[int, int, int]]:
    """Return the triangles of a face, found in its projection along the largest component of its normal."""
    normal = _area_vector(face.outline_mm)
    along = int(np.abs(normal).argmax())
    first, second = (along + 1) % 3, (along + 2) % 3
    plane = [first, second] if normal[along] > 0 else [second, first]
    return triangulate(face.outline_mm[:, plane], tuple(hole[:, plane] for hole in face.holes_mm))


def _area_vector(outline: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.cross(outline, np.roll(outline, -1, axis=0)).sum(axis=0))
