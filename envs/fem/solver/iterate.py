"""The iterate of a solve, the step that leads on from it, and the list of pairs that may touch on the way."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel, kernel, large_kernel
from ..algebra.rows import add_rows, copy_rows, scale_rows
from ..contact.broad_phase import Candidates, find_candidates, relative_motion
from ..contact.memory import ContactMemory, remember_slips
from ..model.model import PRESCRIBED, Model
from ..model.points import point_positions
from .assembly import State, StepStart

FloatArray = NDArray[np.float64]

# One iteration moves bodies against each other by at most this much [m]: a free body's first guess can be metres.
LONGEST_MOVE_M = 2e-3
# A new list stays complete for this multiple of the move that asked for it.
_MARGIN = 1.5


class IpcStep(NamedTuple):
    """What an IPC step starts from and goes to, node positions [m] of shape [n, 3]."""

    x_start: FloatArray
    memory: ContactMemory  # of contacts at its start
    x_hat: FloatArray
    x_target: FloatArray  # of prescribed nodes
    escapes_saddle: bool  # whether the state at hand is an unstable equilibrium, to be left first
    relaxes: bool  # whether forces are relaxed before the first turn
    held: FloatArray  # forces [N], shape [n, 3], that are taken away from the step's own


class NewtonStep(NamedTuple):
    """A step of all nodes and what it does to the surface."""

    solution: FloatArray  # [3 u] of the unknowns [m]
    x: FloatArray  # [n, 3] of the nodes [m]
    y: FloatArray  # [p, 3] of the points [m]
    motion_ahead: FloatArray  # [k] motion of pairs of bodies at its end, since the candidates were listed [m]
    body_motion: FloatArray  # [b, 4] mean motion of each body [m] and the largest relative to it, see `relative_motion`


class Listing(NamedTuple):
    """For which state and motion the candidates are complete."""

    y: FloatArray  # [p, 3] points when the list was made [m]
    margin: FloatArray  # [k] motion that the list stays complete for [m]
    reach: FloatArray  # [k] distance up to which pairs are listed [m]


class Solve(NamedTuple):
    """Arrays of one solve."""

    iterate: State
    trial: State
    start: StepStart
    step: NewtonStep
    listing: Listing


@allocating_kernel
def new_solve(model: Model, x: FloatArray, step: IpcStep) -> Solve:
    """Return the arrays of a solve that moves nodes x [m] of shape [n, 3]."""
    points, pairs, nodes = len(model.points.node_count), len(model.surfaces.pairs), len(x)
    solve = Solve(
        State(x, np.empty((points, 3)), np.zeros(pairs)),
        State(np.empty((nodes, 3)), np.empty((points, 3)), np.zeros(pairs)),
        StepStart(step.x_hat, np.empty((points, 3)), step.memory, step.held),
        NewtonStep(
            np.empty(3 * len(model.unknowns.node)),
            np.zeros((nodes, 3)),
            np.empty((points, 3)),
            np.zeros(pairs),
            np.empty((len(model.surfaces.point_start) - 1, 4)),
        ),
        Listing(np.empty((points, 3)), np.full(pairs, model.parameters.candidate_margin_m), np.empty(pairs)),
    )
    point_positions(model.points, step.x_start, solve.start.y_start)
    point_positions(model.points, x, solve.iterate.y)
    return solve


@allocating_kernel
def list_candidates(model: Model, s: Solve) -> Candidates:
    """List the candidates at the current iterate, with the present margin."""
    s.listing.reach[:] = model.parameters.d_hat_m + s.listing.margin
    copy_rows(s.iterate.y, s.listing.y)
    s.iterate.motion[:] = 0.0
    return find_candidates(model.surfaces, s.iterate.y, s.listing.reach)


@allocating_kernel
def remember_step(model: Model, x: FloatArray, x_start: FloatArray, before: ContactMemory) -> ContactMemory:
    """Return what contacts remember after a step from x_start to x [m] of shape [n, 3], in no order."""
    parameters, points = model.parameters, len(model.points.node_count)
    y, y_start = np.empty((points, 3)), np.empty((points, 3))
    point_positions(model.points, x, y)
    point_positions(model.points, x_start, y_start)
    near = find_candidates(model.surfaces, y, np.full(len(model.surfaces.pairs), parameters.d_hat_m))
    return remember_slips(near, y, y_start, before, parameters.d_hat_m, parameters.slip_scale_m)


@large_kernel
def look_ahead(model: Model, s: Solve) -> bool:
    """Write how far the step moves bodies; return whether the candidates are complete for it.

    If not, the margin is widened and the candidates have to be listed again.
    """
    step, margin = s.step, s.listing.margin
    add_rows(s.iterate.y, 1.0, step.y, s.trial.y)
    add_rows(s.trial.y, -1.0, s.listing.y, s.trial.y)
    relative_motion(model.surfaces, s.trial.y, step.body_motion, step.motion_ahead)
    complete = True
    for k in range(len(margin)):
        complete = complete and not step.motion_ahead[k] > margin[k]
    if not complete:
        relative_motion(model.surfaces, step.y, step.body_motion, step.motion_ahead)
        for k in range(len(margin)):
            margin[k] = max(model.parameters.candidate_margin_m, _MARGIN * step.motion_ahead[k])
    return complete


@kernel
def write_step(model: Model, prescribed_move: FloatArray, step: NewtonStep) -> float:
    """Write the step of the nodes from that of the unknowns; return the largest component of an unknown [m]."""
    copy_rows(prescribed_move, step.x)
    largest = 0.0
    for u in range(len(model.unknowns.node)):
        for k in range(3):
            value = step.solution[3 * u + k]
            step.x[model.unknowns.node[u], k] = value
            largest = max(largest, abs(value))
    return largest


@large_kernel
def shorten_long_move(model: Model, step: NewtonStep) -> float:
    """Cut the move down to the longest allowed; return how far it would have moved bodies against each other [m]."""
    point_positions(model.points, step.x, step.y)
    longest = relative_motion(model.surfaces, step.y, step.body_motion, step.motion_ahead)
    if longest > LONGEST_MOVE_M:
        scale_rows(LONGEST_MOVE_M / longest, step.x)
        scale_rows(LONGEST_MOVE_M / longest, step.y)
    return longest


@large_kernel
def make_step(model: Model, s: Solve, fraction: float, x_target: FloatArray, arriving: bool) -> None:
    """Move the iterate by a part of the step; `arriving` puts the prescribed nodes at their targets exactly."""
    add_rows(s.iterate.x, fraction, s.step.x, s.iterate.x)
    if arriving:
        _place_prescribed(model, x_target, s.iterate.x)
    point_positions(model.points, s.iterate.x, s.iterate.y)
    add_rows(s.iterate.y, -1.0, s.listing.y, s.trial.y)
    relative_motion(model.surfaces, s.trial.y, s.step.body_motion, s.iterate.motion)


@kernel
def write_remaining_motion(model: Model, x: FloatArray, x_target: FloatArray, prescribed_move: FloatArray) -> float:
    """Write the motion left for the prescribed nodes; return its largest component [m]."""
    largest = 0.0
    for node in range(len(x)):
        if model.unknowns.slot[node] == PRESCRIBED:
            for k in range(3):
                prescribed_move[node, k] = x_target[node, k] - x[node, k]
                largest = max(largest, abs(prescribed_move[node, k]))
    return largest


@kernel
def _place_prescribed(model: Model, x_target: FloatArray, x: FloatArray) -> None:
    """Write the targets of the prescribed nodes, which adding up moves would miss by rounding."""
    for node in range(len(x)):
        if model.unknowns.slot[node] == PRESCRIBED:
            for k in range(3):
                x[node, k] = x_target[node, k]
