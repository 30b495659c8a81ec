"""Inertia of the end of a step: lumped in gels, consistent in affine bodies.

    E(x) = 1/(2 h^2) sum_ij m_ij (x_i - x_hat_i) . (x_j - x_hat_j),   x_hat = x + h v at the start of the step    [J]

m is diagonal for gels (a quarter of each tetrahedron's mass at each corner); for a body it is the 4 x 4 matrix of its
frame points. Implicit Euler as in Li et al., Incremental Potential Contact (ACM TOG 2020), equation 3.
"""

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from .linear_solve import block_place
from .model import Model
from .vec3 import add_to_row, load, scale, subtract
from .workspace import NO_MATRIX, Workspace

FloatArray = NDArray[np.float64]


@kernel
def add_inertia(model: Model, x: FloatArray, x_hat: FloatArray, workspace: Workspace, matrix: int) -> None:
    """Add the force m (x - x_hat) / h^2 [N] and the matrix m / h^2 [N/m] of free nodes and movable bodies."""
    inverse_h2 = 1.0 / (model.parameters.time_step_s * model.parameters.time_step_s)
    for u in range(model.system.block.n // 3):
        node = model.unknowns.node[u]
        _add_mass(model, node, node, u, u, model.unknowns.node_mass_kg[node] * inverse_h2, x, x_hat, workspace, matrix)
    affine = model.affine
    for i in range(len(affine.first_node)):
        node, unknown = affine.first_node[i], affine.first_unknown[i]
        for k in range(4):
            for j in range(4):
                mass = affine.mass_kg[i, k, j] * inverse_h2
                _add_mass(model, node + k, node + j, unknown + k, unknown + j, mass, x, x_hat, workspace, matrix)


@kernel
def _add_mass(
    model: Model,
    node_a: int,
    node_b: int,
    a: int,
    b: int,
    m: float,
    x: FloatArray,
    x_hat: FloatArray,
    workspace: Workspace,
    matrix: int,
) -> None:
    add_to_row(workspace.gradient, node_a, scale(m, subtract(load(x, node_b), load(x_hat, node_b))))
    if matrix != NO_MATRIX:
        place, stride = block_place(model.system.block, a, b)
        for k in range(3):
            workspace.entries[place + k * (stride + 1)] += m
