"""Closest points of the two types of primitive pairs, and what the distance's derivatives need.

The closest points of a pair are r = sum_i c_i x_i apart, where x_0..x_3 are the pair's points and the coefficients c
sum to zero: point-triangle (p, t0, t1, t2) has c = (1, -b0, -b1, -b2); edge-edge (a0, a1, b0, b1) has
c = (1 - s, s, -(1 - t), -t). The distance is d = |r|, its direction n = r / d.

A coefficient that is not clamped to 0 or 1 may move: such a *sliding direction* moves weight from point j to point i,
dc = e_i - e_j, and the closest point with it by T = x_i - x_j. A pair has none (point-point), one (point-edge) or two
(point-triangle, edge-edge) of them. By the envelope theorem

    grad d    = c (x) n
    hessian d = c c^T (x) (I - n n^T) / d  -  d M G^-1 M^T,   M_k = dc_k (x) n + c (x) T_k / d,   G_kl = T_k . T_l

where (x) is the Kronecker product over points and coordinates. Cases as in Li et al., Incremental Potential Contact
(2020), supplement; tests compare with ipctk.
"""

from ...compilation import kernel
from ..algebra import Vec3, add, dot, scale, subtract

POINT_TRIANGLE = 0
EDGE_EDGE = 1

Coefficients = tuple[float, float, float, float]
# Sliding directions (i, j, k, l): the first moves weight from j to i, the second from l to k; -1 where there is none.
Sliding = tuple[int, int, int, int]
NO_SLIDING = (-1, -1, -1, -1)


@kernel
def closest_points(pair_type: int, x0: Vec3, x1: Vec3, x2: Vec3, x3: Vec3) -> tuple[Coefficients, Sliding, Vec3]:
    """Return the coefficients, sliding directions and separation r [m] of a pair of the given type."""
    c, sliding = point_triangle(x0, x1, x2, x3) if pair_type == POINT_TRIANGLE else edge_edge(x0, x1, x2, x3)
    r = add(add(scale(c[0], x0), scale(c[1], x1)), add(scale(c[2], x2), scale(c[3], x3)))
    return c, sliding, r


@kernel
def point_triangle(p: Vec3, t0: Vec3, t1: Vec3, t2: Vec3) -> tuple[Coefficients, Sliding]:
    """Return the closest point of triangle (t0, t1, t2) to p (Ericson, Real-Time Collision Detection, 5.1.5)."""
    ab, ac, ap = subtract(t1, t0), subtract(t2, t0), subtract(p, t0)
    d1, d2 = dot(ab, ap), dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return (1.0, -1.0, 0.0, 0.0), NO_SLIDING
    bp = subtract(p, t1)
    d3, d4 = dot(ab, bp), dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return (1.0, 0.0, -1.0, 0.0), NO_SLIDING
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        return (1.0, v - 1.0, -v, 0.0), (1, 2, -1, -1)
    cp = subtract(p, t2)
    d5, d6 = dot(ab, cp), dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return (1.0, 0.0, 0.0, -1.0), NO_SLIDING
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        return (1.0, w - 1.0, 0.0, -w), (1, 3, -1, -1)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return (1.0, 0.0, w - 1.0, -w), (2, 3, -1, -1)
    total = va + vb + vc
    v, w = vb / total, vc / total
    return (1.0, v + w - 1.0, -v, -w), (1, 2, 1, 3)


@kernel
def edge_edge(a0: Vec3, a1: Vec3, b0: Vec3, b1: Vec3) -> tuple[Coefficients, Sliding]:
    """Return the closest points of segments (a0, a1) and (b0, b1), clamped (Ericson, as above, 5.1.9).

    For parallel segments any of the closest point pairs may be returned; their distance is the same.
    """
    u, v, r = subtract(a1, a0), subtract(b1, b0), subtract(a0, b0)
    uu, vv, uv = dot(u, u), dot(v, v), dot(u, v)
    ur, vr = dot(u, r), dot(v, r)
    determinant = uu * vv - uv * uv
    s = 0.0
    if determinant > 1e-14 * uu * vv:
        s = min(max((uv * vr - ur * vv) / determinant, 0.0), 1.0)
    t = (uv * s + vr) / vv
    if t < 0.0:
        t = 0.0
        s = min(max(-ur / uu, 0.0), 1.0)
    elif t > 1.0:
        t = 1.0
        s = min(max((uv - ur) / uu, 0.0), 1.0)
    c = (1.0 - s, s, t - 1.0, -t)
    s_slides = 0.0 < s < 1.0
    t_slides = 0.0 < t < 1.0
    if s_slides and t_slides:
        return c, (1, 0, 2, 3)
    if s_slides:
        return c, (1, 0, -1, -1)
    if t_slides:
        return c, (2, 3, -1, -1)
    return c, NO_SLIDING
