"""Forces of single contacts at a solution, for pictures and measurements, and the slip that contacts carry over."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel, kernel
from ..algebra import (
    Mat3,
    Vec3,
    add,
    apply_columns,
    apply_rows,
    cross,
    dot,
    load,
    scale,
    set_row,
    subtract,
)
from ..model.model import Model, Parameters, Surfaces, point_positions
from .barrier import YIELDED, barrier, drag, mollifier, squared_cross_norm
from .broad_phase import Candidates, find_candidates
from .contact import Quad, weighted_sum
from .distance import EDGE_EDGE, POINT_TRIANGLE, closest_points
from .features import TERM_COUNT, is_inside, new_terms, separation, write_terms

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Columns of `ContactMemory.pairs` that name the pair.
_NAMES = 5
NO_SLIP = (0.0, 0.0, 0.0)
# Cosine of the largest angle between the directions of two contacts of which one continues the other.
_SAME_DIRECTION = 0.5


class ContactMemory(NamedTuple):
    """Pairs in contact at the end of an IPC step, in ascending order of their names, and their elastic slip.

    A point keeps its slip against a body where it goes over to another triangle: what it recalls is the slip of the
    contact with the most similar direction, if there is one. Both are kept in the frame of the triangle, an edge pair's
    slip along and across the edge that lies flatter.
    """

    pairs: IndexArray  # [m, 6] type, four points, and 1 where the second edge of an edge pair is the frame's, else 0
    slip_m: FloatArray  # [m, 3] in the frame [m]
    direction: FloatArray  # [m, 3] of a point-triangle pair, in the frame; zero for edge pairs


def empty_memory() -> ContactMemory:
    """Return the memory of a scene in which nothing sticks."""
    return ContactMemory(np.empty((0, _NAMES + 1), dtype=np.int64), np.empty((0, 3)), np.empty((0, 3)))


def sorted_memory(memory: ContactMemory) -> ContactMemory:
    """Return a memory in ascending order of the names, in which `recall_slip` finds them."""
    order = np.lexsort(memory.pairs[:, _NAMES - 1 :: -1].T)
    return ContactMemory(memory.pairs[order], memory.slip_m[order], memory.direction[order])


@kernel
def recall_slip(
    memory: ContactMemory, surfaces: Surfaces, candidates: Candidates, k: int, y: FloatArray, n: Vec3
) -> Vec3:
    """Return the elastic slip [m] of the candidate k, at points y [m], shape [p, 3]; zero if it was not in contact."""
    pair_type, points = candidates.pair_type[k], candidates.points
    named = _NAMES if pair_type == EDGE_EDGE else 2
    low, high = 0, len(memory.slip_m)
    while low < high:
        middle = (low + high) // 2
        if _precedes(memory.pairs, middle, pair_type, points, k, named):
            low = middle + 1
        else:
            high = middle
    slip, nearest = NO_SLIP, _SAME_DIRECTION
    while low < len(memory.slip_m) and _is_named(memory.pairs, low, pair_type, points, k, named):
        kept = load(memory.slip_m, low)
        if pair_type == EDGE_EDGE:
            along, across = _edge_frame(_corners(points, k, y), n, memory.pairs[low, _NAMES])
            return add(scale(kept[0], along), scale(kept[1], across))
        corner = memory.pairs[low, 2]
        if surfaces.point_body[corner] == surfaces.point_body[points[k, 1]]:
            a, b, c = load(y, corner), load(y, memory.pairs[low, 3]), load(y, memory.pairs[low, 4])
            frame = _triangle_frame(a, b, c)
            likeness = dot(n, apply_columns(frame, load(memory.direction, low)))
            if likeness > nearest:
                slip, nearest = apply_columns(frame, kept), likeness
        low += 1
    return slip


@allocating_kernel
def remember_slips(
    model: Model, candidates: Candidates, y: FloatArray, y_start: FloatArray, before: ContactMemory
) -> ContactMemory:
    """Return the elastic slips at the end of a step, of all contacts among the candidates, in their order.

    It is what a spring of the tangential stiffness has in it at the friction force: the rest has slid.
    """
    d_hat, stiffness_n_m, terms = model.parameters.d_hat_m, model.parameters.tangential_stiffness_n_m, new_terms()
    capacity = TERM_COUNT * len(candidates.pair_type)
    memory = ContactMemory(np.empty((capacity, _NAMES + 1), np.int64), np.empty((capacity, 3)), np.zeros((capacity, 3)))
    count = 0
    for k in range(len(candidates.pair_type)):
        pair_type, points = candidates.pair_type[k], candidates.points
        x = _corners(points, k, y)
        c, _, r = closest_points(pair_type, x[0], x[1], x[2], x[3])
        if dot(r, r) >= d_hat * d_hat:
            continue
        moves = _moves(points, k, x, y_start)
        counted = write_terms(model.surfaces, candidates.triangle[k], y, x, c, terms)
        for term in range(counted):
            c, _, r = separation(terms, term, x)
            if dot(r, r) >= d_hat * d_hat or terms.factor[term] < 0.0:
                continue
            if pair_type == EDGE_EDGE and not is_inside(terms, term):
                continue
            d = np.sqrt(dot(r, r))
            n = scale(1.0 / d, r)
            w = add(weighted_sum(c, moves), recall_slip(before, model.surfaces, candidates, k, y, n))
            u = subtract(w, scale(dot(w, n), n))
            normal_n = terms.factor[term] * _normal_force(model, candidates, k, d, x)
            size, longest = np.sqrt(dot(u, u)), YIELDED * candidates.friction[k] * normal_n / stiffness_n_m
            if size > longest:
                u = scale(longest / size, u)
            memory.pairs[count, 0], memory.pairs[count, _NAMES] = pair_type, 0
            for i in range(4):
                memory.pairs[count, 1 + i] = points[k, i]
            if pair_type == EDGE_EDGE:
                edge = _flatter_edge(x, n)
                along, across = _edge_frame(x, n, edge)
                memory.pairs[count, _NAMES] = edge
                set_row(memory.slip_m, count, (dot(u, along), dot(u, across), 0.0))
            else:
                frame = _triangle_frame(x[1], x[2], x[3])
                set_row(memory.slip_m, count, apply_rows(frame, u))
                set_row(memory.direction, count, apply_rows(frame, n))
            count += 1
    return ContactMemory(memory.pairs[:count], memory.slip_m[:count], memory.direction[:count])


@kernel
def _corners(points: IndexArray, k: int, y: FloatArray) -> Quad:
    return load(y, points[k, 0]), load(y, points[k, 1]), load(y, points[k, 2]), load(y, points[k, 3])


@kernel
def _moves(points: IndexArray, k: int, x: Quad, y_start: FloatArray) -> Quad:
    """Return how far the points of candidate k have moved in the step [m]."""
    start = _corners(points, k, y_start)
    return subtract(x[0], start[0]), subtract(x[1], start[1]), subtract(x[2], start[2]), subtract(x[3], start[3])


@kernel
def _precedes(pairs: IndexArray, row: int, pair_type: int, points: IndexArray, k: int, named: int) -> bool:
    """Return whether a remembered pair comes before the candidate k, by the first columns."""
    if pairs[row, 0] != pair_type:
        return bool(pairs[row, 0] < pair_type)
    for i in range(named - 1):
        if pairs[row, 1 + i] != points[k, i]:
            return bool(pairs[row, 1 + i] < points[k, i])
    return False


@kernel
def _is_named(pairs: IndexArray, row: int, pair_type: int, points: IndexArray, k: int, named: int) -> bool:
    """Return whether a remembered pair has the first columns of the candidate k."""
    same = pairs[row, 0] == pair_type
    for i in range(named - 1):
        same = same and pairs[row, 1 + i] == points[k, i]
    return bool(same)


@kernel
def _triangle_frame(a: Vec3, b: Vec3, c: Vec3) -> Mat3:
    """Return unit vectors along the first edge of a triangle, across it, and along its normal."""
    along, normal = subtract(b, a), cross(subtract(b, a), subtract(c, a))
    along = scale(1.0 / np.sqrt(dot(along, along)), along)
    normal = scale(1.0 / np.sqrt(dot(normal, normal)), normal)
    return along, cross(normal, along), normal


@kernel
def _edge_frame(x: Quad, n: Vec3, second: int) -> tuple[Vec3, Vec3]:
    """Return unit vectors along an edge of the pair and across it, both across n; zero for an edge along n."""
    edge = _edge(x, second)
    edge = subtract(edge, scale(dot(edge, n), n))
    size = np.sqrt(dot(edge, edge))
    along = scale(1.0 / size, edge) if size > 0.0 else edge
    return along, cross(n, along)


@kernel
def _flatter_edge(x: Quad, n: Vec3) -> int:
    """Return which of a pair's two edges is less along n: 0 or 1."""
    first, second = _edge(x, 0), _edge(x, 1)
    along_first, along_second = dot(first, n), dot(second, n)
    left_first = 1.0 - along_first * along_first / dot(first, first)
    left_second = 1.0 - along_second * along_second / dot(second, second)
    return 1 if left_second > left_first + 0.5 else 0


@kernel
def _edge(x: Quad, second: int) -> Vec3:
    """Return one of the two edges."""
    return subtract(x[1], x[0]) if second else subtract(x[3], x[2])


@kernel
def _normal_force(model: Model, candidates: Candidates, k: int, d: float, x: Quad) -> float:
    """Return the normal force [N] of candidate k at a distance d [m]."""
    _, db_dd, _ = barrier(d, model.parameters.d_hat_m)
    eps, e = candidates.mollifier_eps_m4[k], 1.0
    if eps > 0.0:
        e, _, _ = mollifier(squared_cross_norm(subtract(x[1], x[0]), subtract(x[3], x[2])), eps)
    return float(-model.parameters.barrier_stiffness_n_m * e * db_dd)


class PairForces(NamedTuple):
    """Forces of all pairs closer than d_hat."""

    bodies: IndexArray  # [k, 2] body that the force acts on, and the one that exerts it
    points_m: FloatArray  # [k, 3] closest point on the first body
    forces_n: FloatArray  # [k, 3]
    normals: FloatArray  # [k, 3] unit vectors from the second body to the first
    gaps_m: FloatArray  # [k]
    points: IndexArray  # [k, 4] surface points of the pair
    shares: FloatArray  # [k, 4] of the force that acts on each point, below zero on those of the second body


def no_forces() -> PairForces:
    """Return the forces where nothing touches."""
    return _room_for_forces(0)


@allocating_kernel
def _room_for_forces(count: int) -> PairForces:
    return PairForces(
        np.empty((count, 2), np.int64),
        np.empty((count, 3)),
        np.empty((count, 3)),
        np.empty((count, 3)),
        np.empty(count),
        np.empty((count, 4), np.int64),
        np.empty((count, 4)),
    )


@allocating_kernel
def pair_forces(model: Model, x: FloatArray, x_start: FloatArray, memory: ContactMemory) -> PairForces:
    """Return the forces of contacts at nodes x [m], shape [n, 3], of an IPC step that began at x_start with a memory.

    What the mollifier adds turns nearly parallel edges without pushing either body, and is left out.
    """
    total = len(model.points.node_count)
    y, y_start = np.empty((total, 3)), np.empty((total, 3))
    point_positions(model.points, x, y)
    point_positions(model.points, x_start, y_start)
    d_hat, surfaces, terms = model.parameters.d_hat_m, model.surfaces, new_terms()
    candidates = find_candidates(surfaces, y, np.full(len(surfaces.pairs), d_hat))
    found, count = _room_for_forces(TERM_COUNT * len(candidates.pair_type)), 0
    for k in range(len(candidates.pair_type)):
        pair_type, points = candidates.pair_type[k], candidates.points
        corners = _corners(points, k, y)
        c, _, r = closest_points(pair_type, corners[0], corners[1], corners[2], corners[3])
        if dot(r, r) >= d_hat * d_hat:
            continue
        moves = _moves(points, k, corners, y_start)
        counted, factor, recalled = 1, 1.0, NO_SLIP
        if model.parameters.counts_once:
            counted = write_terms(surfaces, candidates.triangle[k], y, corners, c, terms)
        for term in range(counted):
            if model.parameters.counts_once:
                c, _, r = separation(terms, term, corners)
                factor = terms.factor[term]
                if dot(r, r) >= d_hat * d_hat:
                    continue
            n = scale(1.0 / np.sqrt(dot(r, r)), r)
            if pair_type == POINT_TRIANGLE or term == 0:
                recalled = recall_slip(memory, surfaces, candidates, k, y, n)
            slip = add(weighted_sum(c, moves), recalled)
            normal_n = factor * _normal_force(model, candidates, k, np.sqrt(dot(r, r)), corners)
            force = _force(model.parameters, normal_n, candidates.friction[k], n, slip)
            at = corners[0]
            if pair_type == EDGE_EDGE:
                at = add(scale(c[0], corners[0]), scale(c[1], corners[1]))
            found.bodies[count, 0] = surfaces.point_body[points[k, 0]]
            found.bodies[count, 1] = surfaces.point_body[points[k, 3]]
            set_row(found.points_m, count, at)
            set_row(found.forces_n, count, force)
            set_row(found.normals, count, n)
            found.gaps_m[count] = np.sqrt(dot(r, r))
            for i in range(4):
                found.points[count, i], found.shares[count, i] = points[k, i], c[i]
            count += 1
    return PairForces(
        found.bodies[:count],
        found.points_m[:count],
        found.forces_n[:count],
        found.normals[:count],
        found.gaps_m[:count],
        found.points[:count],
        found.shares[:count],
    )


@kernel
def _force(parameters: Parameters, normal_n: float, coefficient: float, n: Vec3, slip: Vec3) -> Vec3:
    """Return the force of a contact [N] on its first body: N n - A u, see `contact`."""
    u = subtract(slip, scale(dot(slip, n), n))
    slip_scale_m, stiffness_n_m = parameters.slip_scale_m, parameters.tangential_stiffness_n_m
    law = drag(np.sqrt(dot(u, u)), normal_n, coefficient, slip_scale_m, stiffness_n_m)
    return subtract(scale(normal_n, n), scale(law.a_n_m, u))
