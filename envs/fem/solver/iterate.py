"""One Newton iteration: its direction, how far it goes, and what is left of the forces there."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel, kernel, large_kernel
from ..algebra import add_rows, copy_rows, scale_rows
from ..contact.broad_phase import Candidates, find_candidates, relative_motion
from ..contact.ccd import PointMove, contact_free_fraction, inversion_free_fraction
from ..contact.forces import ContactMemory, remember_slips
from ..linear.elimination import factorise, substitute
from ..model.model import EXACT_MATRIX, NO_MATRIX, PRESCRIBED, PROJECTED_MATRIX, Model, point_positions
from .assembly import State, StepStart, Workspace, assemble

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
    guesses: bool  # whether x_hat is the first guess, as far as contact and inversion allow
    held: FloatArray  # forces [N], shape [n, 3], that are taken away from the step's own: loads, and what is held


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
def find_contacts(model: Model, x: FloatArray) -> Candidates:
    """Return the pairs that are not further apart than d_hat at nodes x [m] of shape [n, 3]."""
    y = np.empty((len(model.points.node_count), 3))
    point_positions(model.points, x, y)
    return find_candidates(model.surfaces, y, np.full(len(model.surfaces.pairs), model.parameters.d_hat_m))


@allocating_kernel
def remember_step(
    model: Model, near: Candidates, x: FloatArray, x_start: FloatArray, before: ContactMemory
) -> ContactMemory:
    """Return what contacts remember after a step from x_start to x [m] of shape [n, 3], in no order.

    They are looked for among `near`, a list that is complete at x.
    """
    y, y_start = np.empty((len(model.points.node_count), 3)), np.empty((len(model.points.node_count), 3))
    point_positions(model.points, x, y)
    point_positions(model.points, x_start, y_start)
    return remember_slips(model, near, y, y_start, before)


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


@kernel
def largest_residual(model: Model, gradient: FloatArray) -> float:
    """Return the largest force left on an unknown node or frame point [N]."""
    largest = 0.0
    for node in model.unknowns.node:
        g = gradient[node]
        largest = max(largest, np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]))
    return largest


@kernel
def force_along(model: Model, solution: FloatArray, gradient: FloatArray) -> float:
    """Sum of gradient times step over the unknowns [J]: negative while the forces act along the step."""
    total = 0.0
    for u in range(len(model.unknowns.node)):
        for k in range(3):
            total += solution[3 * u + k] * gradient[model.unknowns.node[u], k]
    return total


@large_kernel
def force_along_at(model: Model, candidates: Candidates, s: Solve, workspace: Workspace, fraction: float) -> float:
    """Return the force along the step, see `force_along`, when a part of it is made."""
    add_rows(s.iterate.x, fraction, s.step.x, s.trial.x)
    point_positions(model.points, s.trial.x, s.trial.y)
    assemble(model, candidates, s.trial, s.start, workspace, NO_MATRIX)
    return force_along(model, s.step.solution, workspace.system.gradient)


# Factors are used again as long as the forces fall to this part.
_REUSING_DROP = 0.1


@large_kernel
def find_direction(model: Model, candidates: Candidates, s: Solve, workspace: Workspace, cautious: bool) -> int:
    """Write the Newton step of the unknowns; returns which matrix gave it, NO_MATRIX if none could.

    A cautious one takes the exact matrix only where all its pivots are positive and, once no prescribed motion is left,
    the step goes with the forces.
    """
    solution, system = s.step.solution, workspace.system
    assemble(model, candidates, s.iterate, s.start, workspace, EXACT_MATRIX)
    if _solve(model, workspace, solution, cautious):
        uphill = cautious and not system.moves[0] and force_along(model, solution, system.gradient) >= 0.0
        if not uphill:
            return EXACT_MATRIX
    assemble(model, candidates, s.iterate, s.start, workspace, PROJECTED_MATRIX)
    return PROJECTED_MATRIX if _solve(model, workspace, solution, True) else NO_MATRIX


@large_kernel
def reuse_factors(model: Model, candidates: Candidates, s: Solve, workspace: Workspace, residual_before: float) -> bool:
    """Write a step with the factors of an earlier iteration; False if the last one did not reduce the forces enough."""
    assemble(model, candidates, s.iterate, s.start, workspace, NO_MATRIX)
    gradient = workspace.system.gradient
    if largest_residual(model, gradient) > _REUSING_DROP * residual_before:
        return False
    for u in range(len(model.unknowns.node)):
        node = model.unknowns.node[u]
        for k in range(3):
            s.step.solution[3 * u + k] = -gradient[node, k]
    substitute(model.system, workspace.factor, s.step.solution)
    return True


@large_kernel
def _solve(model: Model, workspace: Workspace, solution: FloatArray, positive: bool) -> bool:
    if not factorise(model.system, workspace.system.entries, workspace.factor, positive):
        return False
    for i in range(len(solution)):
        solution[i] = workspace.system.right_hand_side[i]
    substitute(model.system, workspace.factor, solution)
    return True


# How far the forces along a cautious step may have turned round at its end, and how often it may be shortened.
_OVERSHOOT = 0.5
_SHORTENINGS = 8


@large_kernel
def feasible_fraction(model: Model, candidates: Candidates, s: Solve) -> float:
    """Return the largest part of the step on which no pair closes too much of its gap and no element inverts."""
    fraction = inversion_free_fraction(model.elastic, model.hexahedra, s.iterate.x, s.step.x, 1.0)
    points = PointMove(s.iterate.y, s.step.y, s.iterate.motion, s.step.motion_ahead)
    return contact_free_fraction(candidates, points, model.parameters.ccd_gap_fraction, fraction)


@large_kernel
def falling_fraction(model: Model, candidates: Candidates, s: Solve, workspace: Workspace, fraction: float) -> float:
    """Return the part of a step away from a balance at whose end the forces still act along it; by halving."""
    bound_motion(s)
    for _ in range(_SHORTENINGS):
        if force_along_at(model, candidates, s, workspace, fraction) < 0.0:
            break
        fraction *= 0.5
    return fraction


@large_kernel
def fraction_without_overshoot(
    model: Model, candidates: Candidates, s: Solve, workspace: Workspace, fraction: float
) -> float:
    """Return the part of a step at whose end the forces along it are turned round by half at most; by regula falsi."""
    here = force_along(model, s.step.solution, workspace.system.gradient)
    bound_motion(s)
    for _ in range(_SHORTENINGS):
        there = force_along_at(model, candidates, s, workspace, fraction)
        if there <= -_OVERSHOOT * here:
            break
        fraction *= max(0.1, min(0.5, here / (here - there)))
    return fraction


@kernel
def bound_motion(s: Solve) -> None:
    """Write a bound of how far pairs of bodies have moved anywhere along the step."""
    for k in range(len(s.trial.motion)):
        s.trial.motion[k] = max(s.iterate.motion[k], s.step.motion_ahead[k])
