"""Whether a solution is stable, and how to leave one that is a saddle.

A solution whose exact Jacobian has a negative determinant has a direction of negative curvature, in which it moves away
by itself. Escaping it starts with a step in such a direction, for as long as the forces act along it.
"""

import numpy as np

from ...compilation import large_kernel
from ..contact.broad_phase import Candidates
from ..linear.elimination import factorise, has_negative_determinant, negative_curvature_direction
from ..model.model import Model
from ..model.newton_system import EXACT_MATRIX, NO_MATRIX, PROJECTED_MATRIX
from .assembly import assemble
from .iterate import LONGEST_MOVE_M, Solve
from .workspace import Workspace


@large_kernel
def is_stable(model: Model, candidates: Candidates, s: Solve, workspace: Workspace, matrix: int) -> bool:
    """Return whether the exact Jacobian has no negative determinant.

    A projected one cannot tell and is replaced, as is one whose friction had dual variables on their way.
    """
    if matrix == PROJECTED_MATRIX or model.parameters.remembers_slip:
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
