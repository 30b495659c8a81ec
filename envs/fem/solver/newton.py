"""Solves one IPC step by Newton's method on the forces, with the exact Jacobian of friction.

The step's forces are not the gradient of an energy once friction is taken at the solution, so the matrix is unsymmetric
and there is no energy to descend. Newton's iterations come in turns of two sorts:

- *free* ones take the whole Newton step, as far as contact and inversion allow. Nearly every IPC step is solved within
  the first turn, converging quadratically.
- *cautious* ones take the exact matrix only where all its pivots are positive, otherwise the projected one, which is
  positive semi-definite, and shorten a step that would overshoot: the forces' component along it may not have turned
  round by more than half. They lead out of the cycles and past the saddle points that trap free iterations.

Near the solution free iterations use the last matrix's factors again as long as the forces fall fast (the chord method:
Kelley, Iterative Methods for Linear and Nonlinear Equations, 1995, section 5.4), which spares most of their work.

A solution whose exact Jacobian, as last factorised, has a negative determinant is a saddle: it is refused, and the
caller looks for another by dividing the driven motion. Where that leads to none, the saddle can be escaped along
negative curvature; iterations after that step are cautious ones. Where these crawl and use up their number, as many
more may follow in turns of both sorts. Where nothing else helps the caller asks for the forces to be relaxed before the
first turn (see `relaxation`), which leaves little to Newton's method.

The caller may hold forces: they are taken away from the step's own. With those that the step leaves unbalanced at its
start, the start is a solution; let go little by little, they lead from there to the step's end along balances (Newton
homotopy; Allgower & Georg, Introduction to Numerical Continuation Methods, 1990).
"""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel, kernel, large_kernel
from ..algebra import add_rows
from ..contact.broad_phase import Candidates
from ..linear.elimination import factorise, has_negative_determinant, negative_curvature_direction
from ..model.model import EXACT_MATRIX, NO_MATRIX, PROJECTED_MATRIX, Model
from .assembly import Workspace, assemble
from .iterate import (
    LONGEST_MOVE_M,
    IpcStep,
    Solve,
    falling_fraction,
    feasible_fraction,
    find_direction,
    fraction_without_overshoot,
    largest_residual,
    list_candidates,
    look_ahead,
    make_step,
    new_solve,
    reuse_factors,
    shorten_long_move,
    write_remaining_motion,
    write_step,
)
from .relaxation import relax


@large_kernel
def is_stable(model: Model, candidates: Candidates, s: Solve, workspace: Workspace, matrix: int) -> bool:
    """Return whether the exact Jacobian has no negative determinant.

    A projected one cannot tell and is replaced, as is one with a negative pivot whose friction had dual variables on
    their way.
    """
    on_the_way = model.parameters.remembers_slip and workspace.factor.negative_pivots[0] > 0
    if matrix == PROJECTED_MATRIX or on_the_way:
        assemble(model, candidates, s.iterate, s.start, workspace, EXACT_MATRIX)
        if not factorise(model.system, workspace.system.entries, workspace.factor, False):
            return False
    return not has_negative_determinant(workspace.factor)


@large_kernel
def find_escape(model: Model, candidates: Candidates, s: Solve, workspace: Workspace) -> int:
    """Write a longest step along negative curvature; NO_MATRIX if there is none."""
    solution = s.step.solution
    assemble(model, candidates, s.iterate, s.start, workspace, EXACT_MATRIX)
    if not factorise(model.system, workspace.system.entries, workspace.factor, False):
        return NO_MATRIX
    negative_curvature_direction(model.system, workspace.factor, solution)
    largest = 0.0
    for i in range(len(solution)):
        largest = max(largest, abs(solution[i]))
    if not 0.0 < largest < np.inf:
        return NO_MATRIX
    for i in range(len(solution)):
        solution[i] *= LONGEST_MOVE_M / largest
    return EXACT_MATRIX


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


class StepMeasure(IntEnum):
    """Places in the array of measures that `solve_step` fills."""

    RESIDUAL_N = 0
    SMALLEST_GAP_M = 1
    SMALLEST_DET_F = 2


class Record(NamedTuple):
    """What is counted and measured while solving, by `Counter` and `StepMeasure`."""

    counts: IndexArray
    measures: FloatArray


# Factors are used again after a whole step of at most this size [m].
_REUSING_STEP_M = 1e-5
# Below this size [m] a cautious step is not checked: rounding would decide.
_UNCHECKED_STEP_M = 1e-7


@allocating_kernel
def solve_step(
    model: Model, x: FloatArray, step: IpcStep, tolerances: Tolerances, workspace: Workspace, record: Record
) -> tuple[int, Candidates]:
    """Move nodes x [m] of shape [n, 3] to the solution with the prescribed nodes at x_target.

    Returns how that ended, and the candidates at its end.

    Friction is measured from x_start, inertia from x_hat. The prescribed motion is part of the Newton step and is
    applied as far as contact allows in each iteration. Whatever the outcome, x is free of intersections and inversions.
    """
    s, system = new_solve(model, x, step), workspace.system
    if step.relaxes:
        record.counts[Counter.ITERATIONS] += relax(
            model, s, step.x_target, tolerances.residual_n, 2 * tolerances.iterations, workspace
        )
    candidates = list_candidates(model, s)
    if step.guesses:
        add_rows(step.x_hat, -1.0, x, s.step.x)
        shorten_long_move(model, s.step)
        if not look_ahead(model, s):
            candidates = list_candidates(model, s)
        make_step(model, s, feasible_fraction(model, candidates, s), step.x_target, False)
    turn, residual, reusable, escaping = 0, np.inf, False, step.escapes_saddle
    limit = 2 * tolerances.iterations if step.escapes_saddle else tolerances.iterations
    while turn < limit:
        left = write_remaining_motion(model, x, step.x_target, system.prescribed_move)
        only_cautious = step.escapes_saddle and turn < tolerances.iterations
        cautious = only_cautious or _is_cautious(turn, tolerances.phase_iterations)
        matrix = EXACT_MATRIX
        reused = reusable and not cautious and reuse_factors(model, candidates, s, workspace, residual)
        if escaping:
            matrix = find_escape(model, candidates, s, workspace)
        elif not reused:
            matrix = find_direction(model, candidates, s, workspace, cautious)
            record.counts[Counter.PROJECTED_ITERATIONS] += int(matrix != EXACT_MATRIX)
        if matrix == NO_MATRIX:
            return UNSOLVED, candidates
        turn += int(not reused)
        size = write_step(model, system.prescribed_move, s.step)
        residual = largest_residual(model, system.gradient)
        _keep(workspace, residual, reused, record)
        arrived = left == 0.0 and size <= tolerances.step_m and residual <= tolerances.residual_n
        if arrived and not escaping:
            if is_stable(model, candidates, s, workspace, matrix):
                return SOLVED, candidates
            record.counts[Counter.UNSTABLE] += 1
            return UNSTABLE, candidates
        longest = shorten_long_move(model, s.step)
        if not look_ahead(model, s):
            candidates = list_candidates(model, s)
        fraction = feasible_fraction(model, candidates, s)
        if escaping:
            fraction = falling_fraction(model, candidates, s, workspace, fraction)
        elif cautious and left == 0.0 and size > _UNCHECKED_STEP_M:
            fraction = fraction_without_overshoot(model, candidates, s, workspace, fraction)
        arriving = fraction == 1.0 and longest <= LONGEST_MOVE_M
        make_step(model, s, fraction, step.x_target, arriving)
        whole = fraction == 1.0 and left == 0.0
        reusable = whole and matrix == EXACT_MATRIX and not cautious and size <= _REUSING_STEP_M
        escaping = False
    return UNSOLVED, candidates


@allocating_kernel
def forces_at(model: Model, x: FloatArray, step: IpcStep, workspace: Workspace) -> FloatArray:
    """Return the forces of a step at nodes x [m], gradient of its potential [N]; shapes [n, 3]."""
    s = new_solve(model, x, step)
    assemble(model, list_candidates(model, s), s.iterate, s.start, workspace, NO_MATRIX)
    return workspace.system.gradient.copy()


@kernel
def _is_cautious(iteration: int, length: int) -> bool:
    """Return whether an iteration is cautious: turns alternate, and each cautious one is twice as long as the last."""
    cautious = length
    while iteration >= length + cautious:
        iteration -= length + cautious
        cautious *= 2
    return iteration >= length


@kernel
def _keep(workspace: Workspace, residual: float, reused: bool, record: Record) -> None:
    """Count an iteration, and keep what it found."""
    record.counts[Counter.REUSING_ITERATIONS] += int(reused)
    record.counts[Counter.ITERATIONS] += 1
    record.counts[Counter.ACTIVE_CONTACTS] = workspace.active[0]
    record.measures[StepMeasure.RESIDUAL_N] = residual
    record.measures[StepMeasure.SMALLEST_GAP_M] = workspace.smallest[0]
    record.measures[StepMeasure.SMALLEST_DET_F] = workspace.smallest[1]
