"""Which distances a pair of primitives stands for, so that every place of a surface counts once.

Plain IPC (Li et al. 2020) sums the barrier over all pairs: a point above the edge that two coplanar triangles share
counts twice, and beside it is pushed sideways. Here the sum over a surface is that of Li et al., *Convergent
Incremental Potential Contact* (2023), section 4: by inclusion and exclusion, triangles less edges plus vertices,

    b(x) = sum_t b(d(x, t)) - sum_e b(d(x, e)) + sum_v b(d(x, v)),

of which on a flat face the distance to the face is left, whatever its triangulation. Most terms cancel, so the factor
of each distance is counted beforehand from where the closest points are: 1 inside of a triangle; for an edge the
number of its two triangles whose closest point is on it, less 1; for a vertex that number of triangles, less that of
edges, plus 1. In the same way a pair of edges counts less its four ends against the other edge, which their points
count already, plus these ends against each other: where a closest point is an end, next to nothing is left.

All are continuous with their first derivative, as distances are: where a closest point leaves a primitive, what the
next one counts has the same distance and direction.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel, kernel, large_kernel
from ..algebra import Vec3, add, cross, dot, load, scale, subtract
from ..model.model import Surfaces
from .broad_phase import NO_TRIANGLE
from .contact import Quad
from .distance import NO_SLIDING, Coefficients, Sliding

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# An edge pair, its ends against the edges, and against each other; a triangle with its edges and corners has 7.
TERM_COUNT = 9


class Above(NamedTuple):
    """A point above a triangle."""

    surfaces: Surfaces
    triangle: int
    y: FloatArray  # [p, 3] all points [m]
    point: Vec3  # [m]


class Terms(NamedTuple):
    """Scratch for the distances that one pair stands for, in terms of the pair's four points."""

    factor: FloatArray  # [9] how often a distance counts; negative where others have counted it too often
    coefficients: FloatArray  # [9, 4] of the closest points, see `distance`
    sliding: IndexArray  # [9, 4] see `distance`


@allocating_kernel
def new_terms() -> Terms:
    """Return uninitialised scratch."""
    return Terms(np.empty(TERM_COUNT), np.empty((TERM_COUNT, 4)), np.empty((TERM_COUNT, 4), np.int64))


@kernel
def separation(terms: Terms, term: int, x: Quad) -> tuple[Coefficients, Sliding, Vec3]:
    """Return the coefficients, sliding directions and separation r [m] of a term, like `closest_points`."""
    w, s = terms.coefficients, terms.sliding
    c = (w[term, 0], w[term, 1], w[term, 2], w[term, 3])
    r = add(add(scale(c[0], x[0]), scale(c[1], x[1])), add(scale(c[2], x[2]), scale(c[3], x[3])))
    return c, (s[term, 0], s[term, 1], s[term, 2], s[term, 3]), r


@kernel
def is_inside(terms: Terms, term: int) -> bool:
    """Return whether the closest point of a term is inside of the triangle, or of both edges."""
    return bool(terms.sliding[term, 2] >= 0)


@large_kernel
def write_terms(surfaces: Surfaces, triangle: int, y: FloatArray, x: Quad, c: Coefficients, terms: Terms) -> int:
    """Write the distances that a pair at points x [m] stands for; return their number.

    Args:
        surfaces: of the scene.
        triangle: of a point-triangle pair, or NO_TRIANGLE.
        y: all points [m], shape [p, 3].
        x: those of the pair [m].
        c: coefficients of its closest points.
        terms: what to write to.
    """
    if triangle == NO_TRIANGLE:
        return _write_edge_terms(x, c, terms)
    return _write_surface_terms(Above(surfaces, triangle, y, x[0]), x, terms)


@kernel
def _write_surface_terms(above: Above, x: Quad, terms: Terms) -> int:
    """Write what a point counts of a triangle, and of those of its edges and corners that no lower triangle has."""
    point, a, b, c = x
    s = _sides(point, a, b, c)
    count = 0
    if s[0] > 0.0 and s[1] > 0.0 and s[2] > 0.0:
        total = s[0] + s[1] + s[2]
        v, w = s[2] / total, s[0] / total
        count = _append(terms, count, 1.0, (1.0, v + w - 1.0, -v, -w), (1, 2, 1, 3))
    count = _append_edge(above, 0, (a, b), s[0], terms, count)
    count = _append_edge(above, 1, (b, c), s[1], terms, count)
    count = _append_edge(above, 2, (c, a), s[2], terms, count)
    for corner in range(3):
        count = _append_corner(above, corner, terms, count)
    return count


@kernel
def _sides(point: Vec3, a: Vec3, b: Vec3, c: Vec3) -> tuple[float, float, float]:
    """Return on which side of the edges (a, b), (b, c) and (c, a) a point is above a triangle: positive inside.

    They are areas of the triangles below the point, times the normal's length.
    """
    ab, bc, ca = subtract(b, a), subtract(c, b), subtract(a, c)
    n = cross(ab, bc)
    return (
        dot(cross(n, ab), subtract(point, a)),
        dot(cross(n, bc), subtract(point, b)),
        dot(cross(n, ca), subtract(point, c)),
    )


@kernel
def _append_edge(above: Above, edge: int, ends: tuple[Vec3, Vec3], side: float, terms: Terms, count: int) -> int:
    """Append a triangle's edge, by its ends and the side that the point is on, where the closest point is inside."""
    neighbour, point = above.surfaces.neighbours[above.triangle, edge], above.point
    if neighbour < above.triangle:
        return count
    a, b = ends
    from_a, from_b = dot(subtract(point, a), subtract(b, a)), dot(subtract(point, b), subtract(a, b))
    if from_a <= 0.0 or from_b <= 0.0:
        return count
    factor = (0.0 if side > 0.0 else 1.0) + (0.0 if _side_of_neighbour(above, neighbour) > 0.0 else 1.0)
    if factor == 1.0:
        return count
    v = from_a / (from_a + from_b)
    if edge == 0:
        return _append(terms, count, factor - 1.0, (1.0, v - 1.0, -v, 0.0), (1, 2, -1, -1))
    if edge == 1:
        return _append(terms, count, factor - 1.0, (1.0, 0.0, v - 1.0, -v), (2, 3, -1, -1))
    return _append(terms, count, factor - 1.0, (1.0, -v, 0.0, v - 1.0), (3, 1, -1, -1))


@kernel
def _side_of_neighbour(above: Above, neighbour: int) -> float:
    """Return on which side of the edge that the triangle shares with its neighbour the point is, above the latter."""
    surfaces, y, point = above.surfaces, above.y, above.point
    corners = surfaces.triangles
    s = _sides(point, load(y, corners[neighbour, 0]), load(y, corners[neighbour, 1]), load(y, corners[neighbour, 2]))
    if surfaces.neighbours[neighbour, 0] == above.triangle:
        return s[0]
    return s[1] if surfaces.neighbours[neighbour, 1] == above.triangle else s[2]


@kernel
def _append_corner(above: Above, corner: int, terms: Terms, count: int) -> int:
    """Append a triangle's corner with the triangles and edges around it."""
    surfaces, y = above.surfaces, above.y
    corners, around = surfaces.triangles, surfaces.around
    vertex = corners[above.triangle, corner]
    first, last = surfaces.around_start[vertex], surfaces.around_start[vertex + 1]
    if around[first] != above.triangle:
        return count
    place = load(y, vertex)
    away, factor = subtract(above.point, place), 1.0
    for k in range(first, last):
        other = around[k]
        at = 0 if corners[other, 0] == vertex else (1 if corners[other, 1] == vertex else 2)
        following = load(y, corners[other, (at + 1) % 3])
        if dot(away, subtract(following, place)) <= 0.0:
            factor -= 1.0
            before = load(y, corners[other, (at + 2) % 3])
            if dot(away, subtract(before, place)) <= 0.0:
                factor += 1.0
    if factor == 0.0:
        return count
    c = (1.0, -1.0 if corner == 0 else 0.0, -1.0 if corner == 1 else 0.0, -1.0 if corner == 2 else 0.0)
    return _append(terms, count, factor, c, NO_SLIDING)


@kernel
def _write_edge_terms(x: Quad, c: Coefficients, terms: Terms) -> int:
    """Write an edge pair less its ends against the edges, plus the ends against each other, as far as they differ."""
    u, v, s, t = subtract(x[1], x[0]), subtract(x[3], x[2]), c[1], -c[3]
    s_inside, t_inside, count = 0.0 < s < 1.0, 0.0 < t < 1.0, 0
    if s_inside and t_inside:
        count = _append(terms, count, 1.0, c, (1, 0, 2, 3))
    # Places of the ends of the second edge on the first one.
    s_0, s_1 = _place_on_edge(subtract(x[2], x[0]), u), _place_on_edge(subtract(x[3], x[0]), u)
    for i in range(2):
        end = 1.0 * i
        t_i = _place_on_edge(subtract(x[i], x[2]), v)
        if 0.0 < t_i < 1.0 and not (s == end and t_inside):
            count = _append(terms, count, -1.0, (1.0 - end, end, t_i - 1.0, -t_i), (2, 3, -1, -1))
        s_i = s_1 if i else s_0
        if 0.0 < s_i < 1.0 and not (t == end and s_inside):
            count = _append(terms, count, -1.0, (1.0 - s_i, s_i, end - 1.0, -end), (1, 0, -1, -1))
        for j in range(2):
            other = 1.0 * j
            factor = 1.0 + (1.0 if s == end and t == other else 0.0)
            factor -= (1.0 if t_i == other else 0.0) + (1.0 if (s_1 if j else s_0) == end else 0.0)
            if factor != 0.0:
                count = _append(terms, count, factor, (1.0 - end, end, other - 1.0, -other), NO_SLIDING)
    return count


@kernel
def _place_on_edge(point: Vec3, edge: Vec3) -> float:
    """Return where on an edge the point closest to another one is, both from the edge's start: 0 to 1."""
    return min(max(dot(point, edge) / dot(edge, edge), 0.0), 1.0)


@kernel
def _append(terms: Terms, count: int, factor: float, c: Coefficients, sliding: Sliding) -> int:
    coefficients, directions = terms.coefficients, terms.sliding
    terms.factor[count] = factor
    coefficients[count, 0], coefficients[count, 1], coefficients[count, 2], coefficients[count, 3] = c
    directions[count, 0], directions[count, 1], directions[count, 2], directions[count, 3] = sliding
    return count + 1
