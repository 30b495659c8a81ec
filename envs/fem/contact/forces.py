"""Forces of single contacts at a solution, for pictures and measurements; the solver itself only sums them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel, kernel
from ..algebra.vec3 import Vec3, add, dot, load, scale, subtract
from ..model.model import Model, Surfaces
from ..model.points import point_positions
from .barrier import barrier
from .broad_phase import Candidates, find_candidates
from .contact import weighted_sum
from .distance import EDGE_EDGE, closest_points
from .friction import slip_factor
from .memory import ContactMemory, recall_slip
from .mollifier import mollifier, squared_cross_norm

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


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
