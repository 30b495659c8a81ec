"""Forces of single contacts at a solution, for pictures and measurements, and the slip that contacts carry over."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel, kernel
from ..algebra import Vec3, add, cross, dot, load, scale, subtract
from ..model.model import Model, Surfaces, point_positions
from .barrier import barrier, mollifier, slip_factor, squared_cross_norm
from .broad_phase import Candidates, find_candidates
from .contact import Quad, weighted_sum
from .distance import EDGE_EDGE, closest_points

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Columns of `ContactMemory.pairs` that name the pair.
_NAMES = 5
_NO_SLIP = (0.0, 0.0, 0.0)


class ContactMemory(NamedTuple):
    """Pairs in contact at the end of an IPC step, in ascending order of their names, and their elastic slip."""

    pairs: IndexArray  # [m, 6] type, four points, and 1 where the second of the pair's edges is the frame's, else 0
    slip_m: FloatArray  # [m, 2] along the edge and across it [m]


def empty_memory() -> ContactMemory:
    """Return the memory of a scene in which nothing sticks."""
    return ContactMemory(np.empty((0, _NAMES + 1), dtype=np.int64), np.empty((0, 2)))


def sorted_memory(memory: ContactMemory) -> ContactMemory:
    """Return a memory in ascending order of the names, in which `recall_slip` finds them."""
    order = np.lexsort(memory.pairs[:, _NAMES - 1 :: -1].T)
    return ContactMemory(np.ascontiguousarray(memory.pairs[order]), np.ascontiguousarray(memory.slip_m[order]))


@kernel
def recall_slip(memory: ContactMemory, pair_type: int, points: IndexArray, k: int, x: Quad, n: Vec3) -> Vec3:
    """Return the elastic slip [m] of the candidate k, in the plane across n; zero if the pair was not in contact."""
    low, high = 0, len(memory.slip_m)
    while low < high:
        middle = (low + high) // 2
        if _precedes(memory.pairs, middle, pair_type, points, k):
            low = middle + 1
        else:
            high = middle
    if low == len(memory.slip_m) or not _is_named(memory.pairs, low, pair_type, points, k):
        return _NO_SLIP
    along, across = _frame(pair_type, x, n, memory.pairs[low, _NAMES])
    return add(scale(memory.slip_m[low, 0], along), scale(memory.slip_m[low, 1], across))


@allocating_kernel
def remember_slips(
    candidates: Candidates, y: FloatArray, y_start: FloatArray, before: ContactMemory, d_hat: float, slip_scale: float
) -> ContactMemory:
    """Return the elastic slips at the end of a step, of all candidates closer than d_hat [m], in their order."""
    total = len(candidates.pair_type)
    pairs, slips = np.empty((total, _NAMES + 1), np.int64), np.empty((total, 2))
    count = 0
    for k in range(total):
        pair_type, points = candidates.pair_type[k], candidates.points
        p0, p1, p2, p3 = points[k, 0], points[k, 1], points[k, 2], points[k, 3]
        x = (load(y, p0), load(y, p1), load(y, p2), load(y, p3))
        c, _, r = closest_points(pair_type, x[0], x[1], x[2], x[3])
        squared = dot(r, r)
        if squared >= d_hat * d_hat:
            continue
        n = scale(1.0 / np.sqrt(squared), r)
        moves = (
            subtract(x[0], load(y_start, p0)),
            subtract(x[1], load(y_start, p1)),
            subtract(x[2], load(y_start, p2)),
            subtract(x[3], load(y_start, p3)),
        )
        w = add(weighted_sum(c, moves), recall_slip(before, pair_type, points, k, x, n))
        u = subtract(w, scale(dot(w, n), n))
        size = np.sqrt(dot(u, u))
        if size > slip_scale:
            u = scale(slip_scale / size, u)
        edge = _longer_edge(pair_type, x, n)
        along, across = _frame(pair_type, x, n, edge)
        pairs[count, 0], pairs[count, _NAMES] = pair_type, edge
        for i in range(4):
            pairs[count, 1 + i] = points[k, i]
        slips[count, 0], slips[count, 1] = dot(u, along), dot(u, across)
        count += 1
    return ContactMemory(pairs[:count], slips[:count])


@kernel
def _precedes(pairs: IndexArray, row: int, pair_type: int, points: IndexArray, k: int) -> bool:
    """Return whether a remembered pair comes before the candidate k."""
    if pairs[row, 0] != pair_type:
        return bool(pairs[row, 0] < pair_type)
    for i in range(4):
        if pairs[row, 1 + i] != points[k, i]:
            return bool(pairs[row, 1 + i] < points[k, i])
    return False


@kernel
def _is_named(pairs: IndexArray, row: int, pair_type: int, points: IndexArray, k: int) -> bool:
    return bool(
        pairs[row, 0] == pair_type
        and pairs[row, 1] == points[k, 0]
        and pairs[row, 2] == points[k, 1]
        and pairs[row, 3] == points[k, 2]
        and pairs[row, 4] == points[k, 3]
    )


@kernel
def _frame(pair_type: int, x: Quad, n: Vec3, second: int) -> tuple[Vec3, Vec3]:
    """Return unit vectors along an edge of the pair and across it, both across n; zero for an edge along n."""
    edge = _edge(pair_type, x, second)
    edge = subtract(edge, scale(dot(edge, n), n))
    size = np.sqrt(dot(edge, edge))
    along = scale(1.0 / size, edge) if size > 0.0 else edge
    return along, cross(n, along)


@kernel
def _longer_edge(pair_type: int, x: Quad, n: Vec3) -> int:
    """Return which of a pair's two edges is less along n: 0 or 1."""
    first, second = _edge(pair_type, x, 0), _edge(pair_type, x, 1)
    along_first, along_second = dot(first, n), dot(second, n)
    left_first = 1.0 - along_first * along_first / dot(first, first)
    left_second = 1.0 - along_second * along_second / dot(second, second)
    return 1 if left_second > left_first + 0.5 else 0


@kernel
def _edge(pair_type: int, x: Quad, second: int) -> Vec3:
    """Return an edge of the triangle, or one of the two edges."""
    if second == 0:
        return subtract(x[3], x[2])
    return subtract(x[1], x[0]) if pair_type == EDGE_EDGE else subtract(x[3], x[1])


class PairForces(NamedTuple):
    """Forces of all pairs closer than d_hat."""

    bodies: IndexArray  # [k, 2] body that the force acts on, and the one that exerts it
    points_m: FloatArray  # [k, 3] closest point on the first body
    forces_n: FloatArray  # [k, 3]


def no_forces() -> PairForces:
    """Return the forces where nothing touches."""
    return PairForces(np.empty((0, 2), np.int64), np.empty((0, 3)), np.empty((0, 3)))


@allocating_kernel
def pair_forces(model: Model, x: FloatArray, x_start: FloatArray, memory: ContactMemory) -> PairForces:
    """Return the forces of contacts at nodes x [m], shape [n, 3], of an IPC step that began at x_start with a memory.

    What the mollifier adds turns nearly parallel edges without pushing either body, and is left out.
    """
    points = len(model.points.node_count)
    y, y_start = np.empty((points, 3)), np.empty((points, 3))
    point_positions(model.points, x, y)
    point_positions(model.points, x_start, y_start)
    d_hat = model.parameters.d_hat_m
    candidates = find_candidates(model.surfaces, y, np.full(len(model.surfaces.pairs), d_hat))
    total, count = len(candidates.pair_type), 0
    found = PairForces(np.empty((total, 2), np.int64), np.empty((total, 3)), np.empty((total, 3)))
    for k in range(total):
        pair_type, of_pair = candidates.pair_type[k], candidates.points
        p0, p1, p2, p3 = of_pair[k, 0], of_pair[k, 1], of_pair[k, 2], of_pair[k, 3]
        corners = (load(y, p0), load(y, p1), load(y, p2), load(y, p3))
        c, _, r = closest_points(pair_type, corners[0], corners[1], corners[2], corners[3])
        if dot(r, r) >= d_hat * d_hat:
            continue
        moves = (
            subtract(corners[0], load(y_start, p0)),
            subtract(corners[1], load(y_start, p1)),
            subtract(corners[2], load(y_start, p2)),
            subtract(corners[3], load(y_start, p3)),
        )
        n = scale(1.0 / np.sqrt(dot(r, r)), r)
        slip = add(weighted_sum(c, moves), recall_slip(memory, pair_type, of_pair, k, corners, n))
        edges = (subtract(corners[1], corners[0]), subtract(corners[3], corners[2]))
        force = _force(model, candidates, k, r, slip, edges)
        at = corners[0]
        if pair_type == EDGE_EDGE:
            at = add(scale(c[0], corners[0]), scale(c[1], corners[1]))
        found.bodies[count, 0], found.bodies[count, 1] = _body(model.surfaces, p0), _body(model.surfaces, p3)
        for i in range(3):
            found.points_m[count, i], found.forces_n[count, i] = at[i], force[i]
        count += 1
    return PairForces(found.bodies[:count], found.points_m[:count], found.forces_n[:count])


@kernel
def _force(model: Model, candidates: Candidates, k: int, r: Vec3, slip: Vec3, edges: tuple[Vec3, Vec3]) -> Vec3:
    """Return the force of candidate k [N] on its first body: N n - mu N a u, see `contact`."""
    d = np.sqrt(dot(r, r))
    n = scale(1.0 / d, r)
    _, db_dd, _ = barrier(d, model.parameters.d_hat_m)
    eps, e = candidates.mollifier_eps_m4[k], 1.0
    if eps > 0.0:
        e, _, _ = mollifier(squared_cross_norm(edges[0], edges[1]), eps)
    normal = -model.parameters.barrier_stiffness_n_m * e * db_dd
    u = subtract(slip, scale(dot(slip, n), n))
    a, _ = slip_factor(np.sqrt(dot(u, u)), model.parameters.slip_scale_m)
    return subtract(scale(normal, n), scale(candidates.friction[k] * normal * a, u))


@kernel
def _body(surfaces: Surfaces, point: int) -> int:
    """Return the body that a point belongs to."""
    body = 0
    while point >= surfaces.point_start[body + 1]:
        body += 1
    return body
