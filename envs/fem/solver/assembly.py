"""Forces and Newton system of one IPC step, summed over all terms.

The step minimises, at friction forces consistent with its solution,

    E(x) = sum_nodes m |x - x_hat|^2 / (2 h^2) + sum_tets V psi(F) + sum_bodies (affine inertia + orthogonality)
         + sum_pairs (kappa / h^2) e(c) b(d) + sum_contacts mu N f0(|u|)                          [J]

which is the incremental potential of Li et al., Incremental Potential Contact (ACM TOG 2020), equation 5, over h^2.
Each term adds itself; this module calls them in a fixed order.
"""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..affine.orthogonality import add_orthogonality
from ..algebra.rows import any_nonzero
from ..contact.assembly import add_contacts
from ..contact.broad_phase import Candidates
from ..elastic.elasticity import add_elasticity
from ..model.model import Model
from .inertia import add_inertia
from .workspace import NO_MATRIX, Workspace

FloatArray = NDArray[np.float64]


@large_kernel
def assemble(
    model: Model,
    candidates: Candidates,
    motion: FloatArray,
    x: FloatArray,
    x_hat: FloatArray,
    y: FloatArray,
    y_start: FloatArray,
    prescribed_move: FloatArray,
    workspace: Workspace,
    matrix: int,
) -> None:
    """Write the forces, and the system with the matrix asked for, at nodes x [m] with points y.

    Bodies may have moved against each other by `motion` [m] since the candidates were listed, see `broad_phase`. The
    right-hand side also carries the prescribed nodes' motion [m], of shape [n, 3], moved to the known side.
    """
    workspace.gradient[:] = 0.0
    if matrix != NO_MATRIX:
        workspace.entries[:] = 0.0
        workspace.coupling[:] = 0.0
        workspace.moves[0] = any_nonzero(prescribed_move)
    workspace.smallest[1] = add_elasticity(model.elastic, x, prescribed_move, workspace, matrix)
    add_inertia(model, x, x_hat, workspace, matrix)
    add_orthogonality(model.affine, model.system.block, x, workspace, matrix)
    add_contacts(model, candidates, motion, y, y_start, prescribed_move, workspace, matrix)
    if matrix != NO_MATRIX:
        _write_right_hand_side(model, workspace)


@kernel
def _write_right_hand_side(model: Model, workspace: Workspace) -> None:
    gradient, coupling = workspace.gradient, workspace.coupling
    for u in range(len(model.unknowns.node)):
        node = model.unknowns.node[u]
        for k in range(3):
            workspace.right_hand_side[3 * u + k] = -gradient[node, k] - coupling[node, k]
