"""Solves one IPC step by Newton's method on the forces, with the exact Jacobian of friction.

The step's forces are not the gradient of an energy once friction is taken at the solution, so the matrix is unsymmetric
and there is no energy to descend. Newton's iterations come in turns of two kinds:

- *free* ones take the whole Newton step, as far as contact and inversion allow. Nearly every IPC step is solved within
  the first turn, converging quadratically.
- *cautious* ones take the exact matrix only where all its pivots are positive, otherwise the projected one, which is
  positive semi-definite, and shorten a step that would overshoot: the forces' component along it may not have turned
  round by more than half. They lead out of the cycles and past the saddle points that trap free iterations.

Near the solution free iterations use the last matrix's factors again as long as the forces fall fast (the chord method:
Kelley, Iterative Methods for Linear and Nonlinear Equations, 1995, section 5.4), which spares most of their work.

A solution whose exact Jacobian, as last factorised, has a negative determinant has a direction in which it moves away
by itself: it is refused, and the caller looks for another by dividing the driven motion. Where that leads to none, it
can be left: the first move is then one in such a direction, as long as the forces still push that way, and all further
iterations are cautious ones.
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel, kernel, large_kernel
from ..algebra.rows import add_rows, copy_rows, scale_rows
from ..contact.broad_phase import Candidates, find_candidates, relative_motion
from ..contact.ccd import contact_free_fraction, inversion_free_fraction
from ..linear.elimination import factorise, falling_direction, has_negative_determinant, substitute
from ..model.model import PRESCRIBED, Model
from ..model.points import point_positions
from .assembly import assemble
from .workspace import EXACT_MATRIX, NO_MATRIX, PROJECTED_MATRIX, Workspace

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


# How a solve ends: at a solution, at one that is not stable, or at none.
SOLVED = 0
UNSTABLE = 1
UNSOLVED = 2


class Tolerances(NamedTuple):
    """When an IPC step counts as solved, and how long it may take."""

    step_m: float  # largest move of a Newton iteration
    residual_n: float  # largest nodal force left, friction taken at the solution
    iterations: int  # Newton iterations in all that factorise a matrix
    phase_iterations: int  # of a free phase, and of a cautious one


class Counter(IntEnum):
    """Places in the array of counts that `solve_step` fills."""

    ITERATIONS = 0
    PROJECTED_ITERATIONS = 1
    ACTIVE_CONTACTS = 2
    UNSTABLE = 3
    REUSING_ITERATIONS = 4


class Measure(IntEnum):
    """Places in the array of measures that `solve_step` fills."""

    RESIDUAL_N = 0
    SMALLEST_GAP_M = 1
    SMALLEST_DET_F = 2


# How far the forces along a cautious step may have turned round at its end, and how often it may be shortened.
_OVERSHOOT = 0.5
_SHORTENINGS = 8
# One iteration moves bodies against each other by at most this much [m]: a free body's first guess can be metres.
_LONGEST_MOVE_M = 2e-3
# A new list stays complete for so many times the move that asked for it.
_MARGIN = 1.5
# Factors are used again after a whole step of at most this size [m], as long as the forces fall to this part.
_REUSING_STEP_M = 1e-5
_REUSING_DROP = 0.1
# Below this size [m] a cautious step is not checked: rounding would decide.
_UNCHECKED_STEP_M = 1e-7


class _Scratch(NamedTuple):
    """Arrays of one solve; [p, 3] of surface points, [n, 3] of nodes, [k] of pairs of bodies."""

    y: FloatArray  # [p, 3] points at the current iterate [m]
    y_start: FloatArray  # [p, 3] at the start of the IPC step
    y_listed: FloatArray  # [p, 3] when the candidate list was made
    y_move: FloatArray  # [p, 3]
    y_other: FloatArray  # [p, 3]
    move: FloatArray  # [n, 3] the current step [m]
    prescribed_move: FloatArray  # [n, 3] motion left for the prescribed nodes
    trial: FloatArray  # [n, 3]
    solution: FloatArray  # [3 u]
    motion: FloatArray  # [k] of pairs of bodies against each other since the list was made [m]
    motion_ahead: FloatArray  # [k] the same at the end of the current step
    motion_largest: FloatArray  # [k] the larger of both
    margin: FloatArray  # [k] motion that the list stays complete for [m]
    reach: FloatArray  # [k] distance up to which pairs are listed [m]


@allocating_kernel
def _new_scratch(model: Model, nodes: int) -> _Scratch:
    points, pairs = len(model.points.node_count), len(model.surfaces.pairs)
    return _Scratch(
        np.empty((points, 3)),
        np.empty((points, 3)),
        np.empty((points, 3)),
        np.empty((points, 3)),
        np.empty((points, 3)),
        np.zeros((nodes, 3)),
        np.zeros((nodes, 3)),
        np.empty((nodes, 3)),
        np.empty(3 * len(model.unknowns.node)),
        np.zeros(pairs),
        np.zeros(pairs),
        np.zeros(pairs),
        np.full(pairs, model.parameters.candidate_margin_m),
        np.empty(pairs),
    )


@allocating_kernel
def solve_step(
    model: Model,
    x: FloatArray,
    x_start: FloatArray,
    x_hat: FloatArray,
    x_target: FloatArray,
    tolerances: Tolerances,
    counts: IndexArray,
    measures: FloatArray,
    workspace: Workspace,
    pushing: bool,
) -> int:
    """Move nodes x [m] of shape [n, 3] to the solution with the prescribed nodes at x_target; returns how that ended.

    Friction is measured from x_start, inertia from x_hat. The prescribed motion is part of the Newton step and is
    applied as far as contact allows in each iteration. Whatever the outcome, x is free of intersections and inversions.
    With `pushing`, x is an unstable solution, which is left first.
    """
    s = _new_scratch(model, len(x))
    point_positions(model.points, x_start, s.y_start)
    point_positions(model.points, x, s.y)
    candidates = _listed(model, s)
    turn, residual, matrix, reusable = 0, np.inf, NO_MATRIX, False
    pushed = pushing
    while turn < tolerances.iterations:
        left = _remaining_motion(model, x, x_target, s.prescribed_move)
        cautious = pushed or _is_cautious(turn, tolerances.phase_iterations)
        reused = reusable and not cautious and _reuse_factors(model, candidates, x, x_hat, s, workspace, residual)
        if pushing:
            matrix = _find_way_down(model, candidates, x, x_hat, s, workspace)
        elif not reused:
            matrix = _find_direction(model, candidates, x, x_hat, s, workspace, counts, cautious, left)
        if matrix == NO_MATRIX:
            return UNSOLVED
        turn += int(not reused)
        counts[Counter.REUSING_ITERATIONS] += int(reused)
        step = _node_move(model, s.solution, s.prescribed_move, s.move)
        residual = _largest_residual(model, workspace.gradient)
        counts[Counter.ITERATIONS] += 1
        counts[Counter.ACTIVE_CONTACTS] = workspace.active[0]
        measures[Measure.RESIDUAL_N] = residual
        measures[Measure.SMALLEST_GAP_M] = workspace.smallest[0]
        measures[Measure.SMALLEST_DET_F] = workspace.smallest[1]
        arrived = step <= tolerances.step_m and residual <= tolerances.residual_n
        if left == 0.0 and arrived and not pushing:
            if _is_stable(model, candidates, x, x_hat, s, workspace, matrix):
                return SOLVED
            counts[Counter.UNSTABLE] += 1
            return UNSTABLE
        point_positions(model.points, s.move, s.y_move)
        longest = _shorten_long_move(model, s)
        add_rows(s.y, 1.0, s.y_move, s.y_other)
        add_rows(s.y_other, -1.0, s.y_listed, s.y_other)
        relative_motion(model.surfaces, s.y_other, s.motion_ahead)
        if np.any(s.motion_ahead > s.margin):
            relative_motion(model.surfaces, s.y_move, s.motion_ahead)
            s.margin[:] = np.maximum(model.parameters.candidate_margin_m, _MARGIN * s.motion_ahead)
            candidates = _listed(model, s)
        fraction = inversion_free_fraction(model.elastic, x, s.move, 1.0)
        fraction = contact_free_fraction(
            candidates, s.motion, s.motion_ahead, s.y, s.y_move, model.parameters.ccd_gap_fraction, fraction
        )
        if pushing:
            fraction = _while_falling(model, candidates, x, x_hat, s, workspace, fraction)
        elif cautious and left == 0.0 and step > _UNCHECKED_STEP_M:
            fraction = _without_overshoot(model, candidates, x, x_hat, s, workspace, fraction)
        add_rows(x, fraction, s.move, x)
        whole = fraction == 1.0 and left == 0.0
        reusable = whole and matrix == EXACT_MATRIX and not cautious and step <= _REUSING_STEP_M
        if fraction == 1.0 and longest <= _LONGEST_MOVE_M:
            _place_prescribed(model, x_target, x)
        point_positions(model.points, x, s.y)
        add_rows(s.y, -1.0, s.y_listed, s.y_other)
        relative_motion(model.surfaces, s.y_other, s.motion)
        pushing = False
    return UNSOLVED


@allocating_kernel
def _listed(model: Model, s: _Scratch) -> Candidates:
    """List the candidates at the current iterate, with the present margin."""
    s.reach[:] = model.parameters.d_hat_m + s.margin
    copy_rows(s.y, s.y_listed)
    s.motion[:] = 0.0
    return find_candidates(model.surfaces, s.y, s.reach)


@kernel
def _is_cautious(iteration: int, length: int) -> bool:
    """Free and cautious iterations take turns; each cautious turn is twice as long as the one before."""
    cautious = length
    while iteration >= length + cautious:
        iteration -= length + cautious
        cautious *= 2
    return iteration >= length


@allocating_kernel
def _shorten_long_move(model: Model, s: _Scratch) -> float:
    """Cut the move down to the longest allowed; returns how far it would have moved bodies against each other [m]."""
    longest = relative_motion(model.surfaces, s.y_move, s.motion_ahead)
    if longest > _LONGEST_MOVE_M:
        scale_rows(_LONGEST_MOVE_M / longest, s.move)
        scale_rows(_LONGEST_MOVE_M / longest, s.y_move)
    return longest


@large_kernel
def _reuse_factors(
    model: Model,
    candidates: Candidates,
    x: FloatArray,
    x_hat: FloatArray,
    s: _Scratch,
    workspace: Workspace,
    residual_before: float,
) -> bool:
    """Write a step with the factors of an earlier iteration; False if the last one did not reduce the forces enough."""
    assemble(model, candidates, s.motion, x, x_hat, s.y, s.y_start, s.prescribed_move, workspace, NO_MATRIX)
    if _largest_residual(model, workspace.gradient) > _REUSING_DROP * residual_before:
        return False
    for u in range(len(model.unknowns.node)):
        node = model.unknowns.node[u]
        for k in range(3):
            s.solution[3 * u + k] = -workspace.gradient[node, k]
    substitute(model.system, workspace.factor, s.solution)
    return True


@large_kernel
def _find_direction(
    model: Model,
    candidates: Candidates,
    x: FloatArray,
    x_hat: FloatArray,
    s: _Scratch,
    workspace: Workspace,
    counts: IndexArray,
    cautious: bool,
    left: float,
) -> int:
    """Write the Newton step of the unknowns into s.solution; returns which matrix gave it, NO_MATRIX if none could."""
    assemble(model, candidates, s.motion, x, x_hat, s.y, s.y_start, s.prescribed_move, workspace, EXACT_MATRIX)
    if _solve(model, workspace, s.solution, cautious):
        uphill = cautious and left == 0.0 and _force_along(model, s.solution, workspace.gradient) >= 0.0
        if not uphill:
            return EXACT_MATRIX
    counts[Counter.PROJECTED_ITERATIONS] += 1
    assemble(model, candidates, s.motion, x, x_hat, s.y, s.y_start, s.prescribed_move, workspace, PROJECTED_MATRIX)
    return PROJECTED_MATRIX if _solve(model, workspace, s.solution, True) else NO_MATRIX


@large_kernel
def _solve(model: Model, workspace: Workspace, solution: FloatArray, positive: bool) -> bool:
    if not factorise(model.system, workspace.entries, workspace.factor, positive):
        return False
    for i in range(len(solution)):
        solution[i] = workspace.right_hand_side[i]
    substitute(model.system, workspace.factor, solution)
    return True


@large_kernel
def _is_stable(
    model: Model,
    candidates: Candidates,
    x: FloatArray,
    x_hat: FloatArray,
    s: _Scratch,
    workspace: Workspace,
    matrix: int,
) -> bool:
    """Whether the exact Jacobian has no negative determinant; the projected one cannot tell, so it is made anew."""
    if matrix == PROJECTED_MATRIX:
        assemble(model, candidates, s.motion, x, x_hat, s.y, s.y_start, s.prescribed_move, workspace, EXACT_MATRIX)
        if not factorise(model.system, workspace.entries, workspace.factor, False):
            return False
    return not has_negative_determinant(workspace.factor)


@large_kernel
def _find_way_down(
    model: Model,
    candidates: Candidates,
    x: FloatArray,
    x_hat: FloatArray,
    s: _Scratch,
    workspace: Workspace,
) -> int:
    """Write a longest move in a direction in which an unstable solution moves away; NO_MATRIX if there is none."""
    assemble(model, candidates, s.motion, x, x_hat, s.y, s.y_start, s.prescribed_move, workspace, EXACT_MATRIX)
    if not factorise(model.system, workspace.entries, workspace.factor, False):
        return NO_MATRIX
    falling_direction(model.system, workspace.factor, s.solution)
    largest = 0.0
    for i in range(len(s.solution)):
        largest = max(largest, abs(s.solution[i]))
    if not 0.0 < largest < np.inf:
        return NO_MATRIX
    for i in range(len(s.solution)):
        s.solution[i] *= _LONGEST_MOVE_M / largest
    return EXACT_MATRIX


@large_kernel
def _while_falling(
    model: Model,
    candidates: Candidates,
    x: FloatArray,
    x_hat: FloatArray,
    s: _Scratch,
    workspace: Workspace,
    fraction: float,
) -> float:
    """Part of a move away from a balance at whose end the forces still push along it; by halving."""
    for k in range(len(s.motion)):
        s.motion_largest[k] = max(s.motion[k], s.motion_ahead[k])
    for _ in range(_SHORTENINGS):
        if _force_at(model, candidates, x, x_hat, s, workspace, fraction) < 0.0:
            break
        fraction *= 0.5
    return fraction


@large_kernel
def _without_overshoot(
    model: Model,
    candidates: Candidates,
    x: FloatArray,
    x_hat: FloatArray,
    s: _Scratch,
    workspace: Workspace,
    fraction: float,
) -> float:
    """Part of the step at whose end the forces along it have not turned round by more than half; by regula falsi."""
    here = _force_along(model, s.solution, workspace.gradient)
    for k in range(len(s.motion)):
        s.motion_largest[k] = max(s.motion[k], s.motion_ahead[k])
    for _ in range(_SHORTENINGS):
        there = _force_at(model, candidates, x, x_hat, s, workspace, fraction)
        if there <= -_OVERSHOOT * here:
            break
        fraction *= max(0.1, min(0.5, here / (here - there)))
    return fraction


@large_kernel
def _force_at(
    model: Model,
    candidates: Candidates,
    x: FloatArray,
    x_hat: FloatArray,
    s: _Scratch,
    workspace: Workspace,
    fraction: float,
) -> float:
    """Return the force along the solution, see `_force_along`, when a part of the move is made."""
    add_rows(x, fraction, s.move, s.trial)
    point_positions(model.points, s.trial, s.y_other)
    assemble(
        model,
        candidates,
        s.motion_largest,
        s.trial,
        x_hat,
        s.y_other,
        s.y_start,
        s.prescribed_move,
        workspace,
        NO_MATRIX,
    )
    return _force_along(model, s.solution, workspace.gradient)


@kernel
def _force_along(model: Model, solution: FloatArray, gradient: FloatArray) -> float:
    """Sum of gradient times step over the unknowns [J]: negative while the forces push along the step."""
    total = 0.0
    for u in range(len(model.unknowns.node)):
        for k in range(3):
            total += solution[3 * u + k] * gradient[model.unknowns.node[u], k]
    return total


@kernel
def _remaining_motion(model: Model, x: FloatArray, x_target: FloatArray, prescribed_move: FloatArray) -> float:
    """Write the motion left for the prescribed nodes; returns its largest component [m]."""
    largest = 0.0
    for node in range(len(x)):
        if model.unknowns.slot[node] == PRESCRIBED:
            for k in range(3):
                prescribed_move[node, k] = x_target[node, k] - x[node, k]
                largest = max(largest, abs(prescribed_move[node, k]))
    return largest


@kernel
def _node_move(model: Model, solution: FloatArray, prescribed_move: FloatArray, move: FloatArray) -> float:
    """Write the node move of a Newton direction; returns the largest component of an unknown [m]."""
    copy_rows(prescribed_move, move)
    largest = 0.0
    for u in range(len(model.unknowns.node)):
        for k in range(3):
            value = solution[3 * u + k]
            move[model.unknowns.node[u], k] = value
            largest = max(largest, abs(value))
    return largest


@kernel
def _place_prescribed(model: Model, x_target: FloatArray, x: FloatArray) -> None:
    for node in range(len(x)):
        if model.unknowns.slot[node] == PRESCRIBED:
            for k in range(3):
                x[node, k] = x_target[node, k]


@kernel
def _largest_residual(model: Model, gradient: FloatArray) -> float:
    """Largest force left on an unknown node or frame point [N]."""
    largest = 0.0
    for node in model.unknowns.node:
        g = gradient[node]
        largest = max(largest, np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]))
    return largest
