"""How far a move may go: no pair may close more than a fraction of its gap, no element may invert.

Contact: conservative advancement. At the current closest points the plane normal to n separates the two primitives
by the gap d, so along a linear motion each pair of their vertices keeps a gap that is linear in time; the move may go
until the first of them has shrunk to (1 - fraction) d. Where that allows less than the whole move, the closest points
are computed again at that time and the rest of the gap budget is spent from there (additive CCD: Li et al.,
Codimensional IPC, ACM TOG 2021, algorithm 1, with a tighter bound on the approach speed). The result never exceeds the
exact time at which the gap would be (1 - fraction) d.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from ..algebra import Mat3, Vec3, add, cross, dot, load, scale, subtract
from ..model.model import Elastic, Hexahedra, get_mode
from .broad_phase import Candidates, Corners
from .contact import Quad
from .distance import POINT_TRIANGLE, closest_points

FloatArray = NDArray[np.float64]

_ADVANCES = 100
# Stop advancing once a further advance would add less than this part of the move.
_SMALLEST_ADVANCE = 1e-4
# What rounding may take away from a gap, by far, as a part of it.
_CLEAR = 1e-3
# Part of an element's volume that a move leaves at least.
_REMAINING_VOLUME = 0.1


class PointMove(NamedTuple):
    """Surface points, a move of them, and how far pairs of bodies have moved since the candidates were listed."""

    y: FloatArray  # [p, 3] [m]
    move: FloatArray  # [p, 3] [m]
    motion: FloatArray  # [k] at y [m]
    motion_ahead: FloatArray  # [k] at the end of the move [m]


@kernel
def contact_free_fraction(candidates: Candidates, points: PointMove, gap_fraction: float, allowed: float) -> float:
    """Return the largest part, at most `allowed`, of a move of points; it leaves 1 - gap_fraction of each gap.

    A pair that cannot have closed that part of its gap, by how far its bodies have moved, is passed over.
    """
    for k in range(len(candidates.pair_type)):
        body = candidates.bodies[k]
        now, ahead, listed = points.motion[body], points.motion_ahead[body], candidates.distance_m[k]
        if listed - max(now, ahead) >= (1.0 - gap_fraction) * (listed + now):
            continue
        corners = candidates.points
        pair = (corners[k, 0], corners[k, 1], corners[k, 2], corners[k, 3])
        allowed = _pair_fraction(candidates.pair_type[k], pair, points, gap_fraction, allowed)
    return allowed


@kernel
def _pair_fraction(pair_type: int, pair: Corners, points: PointMove, gap_fraction: float, allowed: float) -> float:
    y, move = points.y, points.move
    p0, p1, p2, p3 = pair
    v0, v1, v2, v3 = load(move, p0), load(move, p1), load(move, p2), load(move, p3)
    x0, x1, x2, x3 = load(y, p0), load(y, p1), load(y, p2), load(y, p3)
    _, _, r = closest_points(pair_type, x0, x1, x2, x3)
    if _keeps_gap((x0, x1, x2, x3), (v0, v1, v2, v3), r, gap_fraction, allowed, pair_type):
        return allowed
    floor = (1.0 - gap_fraction) * np.sqrt(dot(r, r))
    time = 0.0
    for _ in range(_ADVANCES):
        advance = _advance((x0, x1, x2, x3), (v0, v1, v2, v3), r, floor, pair_type)
        time += advance
        if time >= allowed:
            return allowed
        if advance < _SMALLEST_ADVANCE:
            return time
        x0, x1 = add(load(y, p0), scale(time, v0)), add(load(y, p1), scale(time, v1))
        x2, x3 = add(load(y, p2), scale(time, v2)), add(load(y, p3), scale(time, v3))
        _, _, r = closest_points(pair_type, x0, x1, x2, x3)
    return time


@kernel
def _keeps_gap(x: Quad, v: Quad, r: Vec3, gap_fraction: float, allowed: float, pair_type: int) -> bool:
    """Return whether the first advance certainly reaches `allowed`: without its divisions, and clear of rounding."""
    squared = dot(r, r)
    budget = max(gap_fraction - _CLEAR, 0.0) * squared
    if pair_type == POINT_TRIANGLE:
        return (
            _keeps_clear(subtract(x[0], x[1]), subtract(v[0], v[1]), r, squared, budget, allowed)
            and _keeps_clear(subtract(x[0], x[2]), subtract(v[0], v[2]), r, squared, budget, allowed)
            and _keeps_clear(subtract(x[0], x[3]), subtract(v[0], v[3]), r, squared, budget, allowed)
        )
    return (
        _keeps_clear(subtract(x[0], x[2]), subtract(v[0], v[2]), r, squared, budget, allowed)
        and _keeps_clear(subtract(x[0], x[3]), subtract(v[0], v[3]), r, squared, budget, allowed)
        and _keeps_clear(subtract(x[1], x[2]), subtract(v[1], v[2]), r, squared, budget, allowed)
        and _keeps_clear(subtract(x[1], x[3]), subtract(v[1], v[3]), r, squared, budget, allowed)
    )


@kernel
def _keeps_clear(x: Vec3, v: Vec3, r: Vec3, squared: float, budget: float, allowed: float) -> bool:
    """Return whether a vertex keeps the gap along r to another one, less the budget: all in squares of the gap."""
    gap = dot(x, r)
    return gap >= (1.0 - _CLEAR) * squared and budget + (gap - squared) > -allowed * dot(v, r) and squared > 0.0


@kernel
def _advance(x: Quad, v: Quad, r: Vec3, floor: float, pair_type: int) -> float:
    """Return the time until the first two vertices of the two primitives have come as near as floor along r."""
    if pair_type == POINT_TRIANGLE:
        return min(
            _vertex_pair_time(x[0], x[1], v[0], v[1], r, floor),
            _vertex_pair_time(x[0], x[2], v[0], v[2], r, floor),
            _vertex_pair_time(x[0], x[3], v[0], v[3], r, floor),
        )
    return min(
        _vertex_pair_time(x[0], x[2], v[0], v[2], r, floor),
        _vertex_pair_time(x[0], x[3], v[0], v[3], r, floor),
        _vertex_pair_time(x[1], x[2], v[1], v[2], r, floor),
        _vertex_pair_time(x[1], x[3], v[1], v[3], r, floor),
    )


@kernel
def _vertex_pair_time(xa: Vec3, xb: Vec3, va: Vec3, vb: Vec3, r: Vec3, floor: float) -> float:
    """Time until the gap of two vertices along r has shrunk to floor; at least 0, infinite if it does not shrink."""
    length = np.sqrt(dot(r, r))
    speed = dot(subtract(va, vb), r) / length
    if speed >= 0.0:
        return np.inf
    return float(max(0.0, (dot(subtract(xa, xb), r) / length - floor) / -speed))


@kernel
def inversion_free_fraction(
    elastic: Elastic, hexahedra: Hexahedra, x: FloatArray, move: FloatArray, allowed: float
) -> float:
    """Return the largest part, up to `allowed`, of a node move [m] of shape [n, 3] that leaves a tenth of each volume.

    Of a hexahedron it is that of its mean deformation.
    """
    nodes = elastic.nodes
    for t in range(len(nodes)):
        n0, n1, n2, n3 = nodes[t, 0], nodes[t, 1], nodes[t, 2], nodes[t, 3]
        a = subtract(load(x, n1), load(x, n0))
        b = subtract(load(x, n2), load(x, n0))
        c = subtract(load(x, n3), load(x, n0))
        da = subtract(load(move, n1), load(move, n0))
        db = subtract(load(move, n2), load(move, n0))
        dc = subtract(load(move, n3), load(move, n0))
        allowed = _volume_keeping_fraction((a, b, c), (da, db, dc), allowed)
    for h in range(len(hexahedra.volume_m3)):
        F = get_mode(hexahedra, h, 0, x), get_mode(hexahedra, h, 1, x), get_mode(hexahedra, h, 2, x)
        dF = get_mode(hexahedra, h, 0, move), get_mode(hexahedra, h, 1, move), get_mode(hexahedra, h, 2, move)
        allowed = _volume_keeping_fraction(F, dF, allowed)
    return allowed


@kernel
def _volume_keeping_fraction(vectors: Mat3, moves: Mat3, allowed: float) -> float:
    """Return the largest part, up to `allowed`, of moves of three vectors that leaves a tenth of their volume.

    Along the move a volume is a cubic in time; dropping its growing terms gives a falling lower bound, which is
    bisected.
    """
    a, b, c = vectors
    da, db, dc = moves
    bc, db_dc = cross(b, c), cross(db, dc)
    mixed = add(cross(b, dc), cross(db, c))
    volume = dot(a, bc)
    linear = min(dot(da, bc) + dot(a, mixed), 0.0)
    quadratic = min(dot(da, mixed) + dot(a, db_dc), 0.0)
    cubic = min(dot(da, db_dc), 0.0)
    if (1.0 - _REMAINING_VOLUME) * volume + allowed * (linear + allowed * (quadratic + allowed * cubic)) < 0.0:
        low, high = 0.0, allowed
        for _ in range(30):
            middle = 0.5 * (low + high)
            left = (1.0 - _REMAINING_VOLUME) * volume + middle * (linear + middle * (quadratic + middle * cubic))
            if left < 0.0:
                high = middle
            else:
                low = middle
        allowed = low
    return allowed
