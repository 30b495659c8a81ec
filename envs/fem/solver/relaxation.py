"""Relaxes an IPC step along the flow of its forces, where Newton's turns lead nowhere; called by `newton`.

Where gels first touch a nearly free part, friction decides: with a coefficient of 44 a contact's tangential force
changes 44 times as fast as its normal force. The exact Jacobian has up to 20 negative pivots there (1 to 3 without
friction) and sends free iterations anywhere. Cautious ones hold friction, and overshoot without end, as there is no
energy that they could descend. Following the flow dx/ds = -gradient needs none: it ends where forces balance and the
balance is stable. Pseudo-transient continuation (Kelley & Keyes, SIAM J. Numer. Anal. 35, 1998) takes linearly implicit
Euler steps,

    (J + damping I) dx = -gradient,

as long as possible: the damping [N/m] is raised until all pivots are positive and until the forces at the end of the
step are those that the Jacobian foretells, and falls from step to step otherwise.
"""

import numpy as np
from numpy.typing import NDArray

from ...compilation import allocating_kernel, kernel, large_kernel
from ..algebra import copy_rows
from ..linear.elimination import factorise, has_negative_determinant, substitute
from ..linear.system import block_place
from ..model.model import EXACT_MATRIX, Model
from .assembly import Workspace, assemble
from .iterate import (
    LONGEST_MOVE_M,
    Solve,
    bound_motion,
    feasible_fraction,
    force_along_at,
    largest_residual,
    list_candidates,
    look_ahead,
    make_step,
    shorten_long_move,
    write_remaining_motion,
    write_step,
)

FloatArray = NDArray[np.float64]

_FIRST_DAMPING_N_M = 1e3
_LEAST_DAMPING_N_M = 1e-2
_LARGEST_DAMPING_N_M = 1e12
_RAISE = 4.0
# Part of the steps after which pivots may be negative in pairs: strong friction has such ones in stable balances too,
# where the damping that makes all of them positive would let the iterate creep.
_POSITIVE_PART = 0.25
# How far the forces at the end of a step may be from the foretold ones, as part of those at its start.
_LARGEST_DEVIATION = 0.5


@allocating_kernel
def relax(model: Model, s: Solve, x_target: FloatArray, residual_n: float, steps: int, workspace: Workspace) -> int:
    """Move the iterate until the forces left are at most `residual_n`; return the number of steps it took."""
    candidates, before = list_candidates(model, s), np.empty_like(s.iterate.x)
    damping = _FIRST_DAMPING_N_M
    for count in range(steps):
        left = write_remaining_motion(model, s.iterate.x, x_target, workspace.system.prescribed_move)
        assemble(model, candidates, s.iterate, s.start, workspace, EXACT_MATRIX)
        copy_rows(workspace.system.gradient, before)
        if left == 0.0 and largest_residual(model, before) <= residual_n:
            return count
        positive = count < _POSITIVE_PART * steps
        damping = _find_damped_direction(model, s, workspace, damping, positive)
        if damping > _LARGEST_DAMPING_N_M:
            return count
        write_step(model, workspace.system.prescribed_move, s.step)
        longest = shorten_long_move(model, s.step)
        if not look_ahead(model, s):
            candidates = list_candidates(model, s)
        fraction = feasible_fraction(model, candidates, s)
        if left == 0.0:
            bound_motion(s)
            force_along_at(model, candidates, s, workspace, fraction)
            made = fraction * min(1.0, LONGEST_MOVE_M / longest)
            deviation = _deviation(model, s, before, workspace.system.gradient, made, fraction * damping)
            damping = _next_damping(damping, deviation)
            if deviation > _LARGEST_DEVIATION:
                continue
        make_step(model, s, fraction, x_target, fraction == 1.0 and longest <= LONGEST_MOVE_M)
    return steps


@large_kernel
def _find_damped_direction(model: Model, s: Solve, workspace: Workspace, damping: float, positive: bool) -> float:
    """Write the step with the assembled matrix; return the damping [N/m], raised until pivots allow it.

    They are to be positive, or else to have a positive product.
    """
    system, solution = workspace.system, s.step.solution
    _add_to_diagonal(model, system.entries, damping)
    while damping <= _LARGEST_DAMPING_N_M and not (
        factorise(model.system, system.entries, workspace.factor, positive)
        and not has_negative_determinant(workspace.factor)
    ):
        _add_to_diagonal(model, system.entries, (_RAISE - 1.0) * damping)
        damping *= _RAISE
    for i in range(len(solution)):
        solution[i] = system.right_hand_side[i]
    substitute(model.system, workspace.factor, solution)
    return damping


@kernel
def _add_to_diagonal(model: Model, entries: FloatArray, damping: float) -> None:
    for u in range(len(model.unknowns.node)):
        place, stride = block_place(model.system.block, u, u)
        for k in range(3):
            entries[place + k * (stride + 1)] += damping


@large_kernel
def _deviation(model: Model, s: Solve, before: FloatArray, after: FloatArray, made: float, damping: float) -> float:
    """Return how far the forces after a step are from (1 - made) before - damping dx, as part of those before."""
    wrong, whole = 0.0, 0.0
    for node in model.unknowns.node:
        for k in range(3):
            foretold = (1.0 - made) * before[node, k] - damping * s.step.x[node, k]
            wrong += (after[node, k] - foretold) ** 2
            whole += before[node, k] * before[node, k]
    return float(np.sqrt(wrong / whole))


@kernel
def _next_damping(damping: float, deviation: float) -> float:
    """Return a larger damping after a step that strayed, and a smaller one after one that ended as foretold."""
    if deviation > _LARGEST_DEVIATION:
        return _RAISE * damping
    if deviation > 0.5 * _LARGEST_DEVIATION:
        return damping
    return max(_LEAST_DAMPING_N_M, (0.3 if deviation > 0.1 * _LARGEST_DEVIATION else 0.1) * damping)
