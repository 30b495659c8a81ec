"""The Newton direction: from the exact Jacobian, from its projection, or from the last factors once more."""

import numpy as np
from numpy.typing import NDArray

from ...compilation import large_kernel
from ..contact.broad_phase import Candidates
from ..linear.elimination import factorise, substitute
from ..model.model import Model
from ..model.newton_system import EXACT_MATRIX, NO_MATRIX, PROJECTED_MATRIX
from .assembly import assemble
from .forces import force_along, largest_residual
from .iterate import Solve
from .workspace import Workspace

FloatArray = NDArray[np.float64]

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
