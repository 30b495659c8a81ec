"""Elastic forces and stiffness of all gels: the material of `neo_hookean`, summed over tetrahedra.

Another material is a module with the functions of `neo_hookean` that are imported here, and its parameters in
`model.Elastic`.
"""

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel
from ..deterministic_math import natural_log
from .linear_system import GEL_STRIDE, add_block
from .mat3 import apply_columns, apply_rows, outer_square, scale_matrix, transpose
from .model import Elastic
from .neo_hookean import cofactors, deformation_gradient, nodal_gradient, projected_stiffness_block, stiffness_block
from .vec3 import Vec3, add, add_to_row, dot, load, scale
from .workspace import NO_MATRIX, PROJECTED_MATRIX, Workspace

FloatArray = NDArray[np.float64]


@kernel
def add_elasticity(
    elastic: Elastic, x: FloatArray, prescribed_move: FloatArray, workspace: Workspace, matrix: int
) -> float:
    """Add all tetrahedra at nodes x [m]; returns the smallest det F.

    Prescribed corners, which move by prescribed_move [m], are added to the coupling where they act on unknown ones.
    """
    nodes, places = elastic.nodes, elastic.places
    volumes, mus, lams = elastic.volume_m3, elastic.mu_pa, elastic.lambda_pa
    gradients, reaction = elastic.gradients_1_m, elastic.reaction
    entries, gradient, coupling = workspace.entries, workspace.gradient, workspace.coupling
    moves = workspace.moves[0]
    rest, bent = np.empty((4, 3)), np.empty((4, 3))
    smallest = np.inf
    for t in range(len(volumes)):
        g1, g2, g3 = _rest_gradient(gradients, t, 1), _rest_gradient(gradients, t, 2), _rest_gradient(gradients, t, 3)
        g = (scale(-1.0, add(add(g1, g2), g3)), g1, g2, g3)
        F = deformation_gradient(
            load(x, nodes[t, 0]), load(x, nodes[t, 1]), load(x, nodes[t, 2]), load(x, nodes[t, 3]), g1, g2, g3
        )
        cofactor, J = cofactors(F)
        smallest = min(smallest, J)
        volume, mu, lam = volumes[t], mus[t], lams[t]
        pressure = lam * natural_log(J) - mu
        inverse_transpose = scale_matrix(1.0 / J, cofactor)
        inverse_b = outer_square(inverse_transpose)
        for a in range(4):
            _store(rest, a, g[a])
            _store(bent, a, apply_columns(inverse_transpose, g[a]))
            force = nodal_gradient(volume, mu, pressure, apply_columns(F, g[a]), load(bent, a))
            add_to_row(gradient, nodes[t, a], force)
        if matrix == NO_MATRIX:
            continue
        for a in range(4):
            ga, ha = load(rest, a), load(bent, a)
            for b in range(a, 4):
                place, mirrored = places[t, 4 * a + b], places[t, 4 * b + a]
                if place < 0 and not (moves and reaction[t, 4 * a + b]):
                    continue
                gg, hb = dot(ga, load(rest, b)), load(bent, b)
                if matrix == PROJECTED_MATRIX:
                    block = projected_stiffness_block(volume, mu, lam, pressure, gg, ha, hb, inverse_b)
                else:
                    block = stiffness_block(volume, mu, lam, pressure, gg, ha, hb)
                if place >= 0:
                    add_block(entries, place, GEL_STRIDE, block)
                    if b > a:
                        add_block(entries, mirrored, GEL_STRIDE, transpose(block))
                else:
                    m, n = nodes[t, a], nodes[t, b]
                    add_to_row(coupling, m, apply_rows(block, load(prescribed_move, n)))
                    add_to_row(coupling, n, apply_columns(block, load(prescribed_move, m)))
    return smallest


@kernel
def _rest_gradient(gradients: FloatArray, t: int, a: int) -> Vec3:
    return gradients[t, a, 0], gradients[t, a, 1], gradients[t, a, 2]


@kernel
def _store(rows: FloatArray, i: int, v: Vec3) -> None:
    rows[i, 0], rows[i, 1], rows[i, 2] = v
