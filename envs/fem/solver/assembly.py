"""Forces and Newton system of one IPC step, summed over all terms.

The step minimises, at friction forces consistent with its solution,

    E(x) = sum_nodes m |x - x_hat|^2 / (2 h^2) + sum_tets V psi(F) + sum_bodies (affine inertia + orthogonality)
         + sum_pairs (kappa / h^2) e(c) b(d) + sum_contacts mu N f0(|u|)                          [J]

which is the incremental potential of Li et al., Incremental Potential Contact (ACM TOG 2020), equation 5, over h^2.
Each term adds itself; this module calls them in a fixed order.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..affine.orthogonality import add_orthogonality
from ..algebra.rows import add_rows, any_nonzero
from ..contact.assembly import PointState, add_contacts
from ..contact.broad_phase import Candidates
from ..contact.memory import ContactMemory
from ..elastic.elasticity import add_elasticity
from ..model.model import Model
from ..model.newton_system import NO_MATRIX, NewtonSystem
from .inertia import add_inertia
from .workspace import Workspace

FloatArray = NDArray[np.float64]


class State(NamedTuple):
    """Where the scene is."""

    x: FloatArray  # [n, 3] nodes [m]
    y: FloatArray  # [p, 3] their surface points [m]
    motion: FloatArray  # [k] largest motion of each pair of bodies since the candidates were listed [m]


class StepStart(NamedTuple):
    """From where inertia and friction of an IPC step are measured."""

    x_hat: FloatArray  # [n, 3] nodes at the end of the step without forces [m]
    y_start: FloatArray  # [p, 3] points at its start [m]
    memory: ContactMemory  # of contacts at its start
    held: FloatArray  # [n, 3] forces that are taken away from those of the potential [N]


@large_kernel
def assemble(
    model: Model, candidates: Candidates, state: State, start: StepStart, workspace: Workspace, matrix: int
) -> None:
    """Write the forces, and the system with the matrix asked for, at a state.

    The right-hand side also carries the system's prescribed motion, moved to the known side.
    """
    system = workspace.system
    system.gradient[:] = 0.0
    if matrix != NO_MATRIX:
        system.entries[:] = 0.0
        system.coupling[:] = 0.0
        system.moves[0] = any_nonzero(system.prescribed_move)
    workspace.smallest[1] = add_elasticity(model.elastic, state.x, workspace.batch, system, matrix)
    add_inertia(model, state.x, start.x_hat, system, matrix)
    add_orthogonality(model.affine, model.system.block, state.x, system, matrix)
    points = PointState(state.y, start.y_start, state.motion, start.memory)
    gap, active = add_contacts(model, candidates, points, workspace.stencil, system, matrix)
    workspace.smallest[0], workspace.active[0] = gap, active
    add_rows(system.gradient, -1.0, start.held, system.gradient)
    if matrix != NO_MATRIX:
        _write_right_hand_side(model, system)


@kernel
def _write_right_hand_side(model: Model, system: NewtonSystem) -> None:
    gradient, coupling = system.gradient, system.coupling
    for u in range(len(model.unknowns.node)):
        node = model.unknowns.node[u]
        for k in range(3):
            system.right_hand_side[3 * u + k] = -gradient[node, k] - coupling[node, k]
