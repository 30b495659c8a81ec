"""The forces of a state as numbers that the solver decides by."""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..algebra.rows import add_rows
from ..contact.broad_phase import Candidates
from ..model.model import Model
from ..model.newton_system import NO_MATRIX
from ..model.points import point_positions
from .assembly import assemble
from .iterate import Solve
from .workspace import Workspace

FloatArray = NDArray[np.float64]


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
