"""Inertia of the end of a step: lumped in gels, consistent in affine bodies.

    E(x) = 1/(2 h^2) sum_ij m_ij (x_i - x_hat_i) . (x_j - x_hat_j),   x_hat = x + h v at the start of the step    [J]

m is diagonal for gels (a quarter of each tetrahedron's mass at each corner); for a body it is the 4 x 4 matrix of its
frame points. Implicit Euler as in Li et al., Incremental Potential Contact (ACM TOG 2020), equation 3.
"""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from ..algebra.vec3 import add_to_row, load, scale, subtract
from ..linear.system import block_place
from ..model.model import Model
from ..model.newton_system import NO_MATRIX, NewtonSystem

FloatArray = NDArray[np.float64]


@kernel
def add_inertia(model: Model, x: FloatArray, x_hat: FloatArray, system: NewtonSystem, matrix: int) -> None:
    """Add the force m (x - x_hat) / h^2 [N] and the matrix m / h^2 [N/m] of free nodes and movable bodies."""
    inverse_h2 = 1.0 / (model.parameters.time_step_s * model.parameters.time_step_s)
    gradient, entries, layout = system.gradient, system.entries, model.system.block
    unknown_nodes, masses = model.unknowns.node, model.unknowns.node_mass_kg
    for u in range(layout.nodes):
        node = unknown_nodes[u]
        m = masses[node] * inverse_h2
        add_to_row(gradient, node, scale(m, subtract(load(x, node), load(x_hat, node))))
        if matrix != NO_MATRIX:
            place, stride = block_place(layout, u, u)
            _add_multiple_of_identity(entries, place, stride, m)
    affine = model.affine
    for i in range(len(affine.first_node)):
        node, unknown = affine.first_node[i], affine.first_unknown[i]
        for k in range(4):
            for j in range(4):
                m = affine.mass_kg[i, k, j] * inverse_h2
                offset = subtract(load(x, node + j), load(x_hat, node + j))
                add_to_row(gradient, node + k, scale(m, offset))
                if matrix != NO_MATRIX:
                    place, stride = block_place(layout, unknown + k, unknown + j)
                    _add_multiple_of_identity(entries, place, stride, m)


@kernel
def _add_multiple_of_identity(entries: FloatArray, place: int, stride: int, m: float) -> None:
    for k in range(3):
        entries[place + k * (stride + 1)] += m
