"""Elastic forces and stiffness of all gels: the material of `neo_hookean`, summed over tetrahedra.

Another material is a module with the functions of `neo_hookean` that are imported here, and its parameters in
`model.Elastic`.
"""

import numpy as np
from numpy.typing import NDArray

from ..compilation import kernel, large_kernel
from ..deterministic_math import natural_log
from .linear_system import GEL_STRIDE, add_block
from .mat3 import Mat3, apply_columns, apply_rows, outer_square, scale_matrix, transpose
from .model import Elastic
from .neo_hookean import cofactors, deformation_gradient, nodal_gradient, projected_stiffness_block, stiffness_block
from .vec3 import Vec3, add, add_to_row, dot, load, scale
from .workspace import NO_MATRIX, PROJECTED_MATRIX, Workspace

FloatArray = NDArray[np.float64]


@large_kernel
def add_elasticity(
    elastic: Elastic, x: FloatArray, prescribed_move: FloatArray, workspace: Workspace, matrix: int
) -> float:
    """Add all tetrahedra at nodes x [m]; returns the smallest det F.

    Prescribed corners, which move by prescribed_move [m], are added to the coupling where they act on unknown ones.
    """
    nodes, gradient = elastic.nodes, workspace.gradient
    volumes, mus, lams = elastic.volume_m3, elastic.mu_pa, elastic.lambda_pa
    smallest = np.inf
    for t in range(len(volumes)):
        g = _rest_gradients(elastic.gradients_1_m, t)
        F = deformation_gradient(
            load(x, nodes[t, 0]), load(x, nodes[t, 1]), load(x, nodes[t, 2]), load(x, nodes[t, 3]), g[1], g[2], g[3]
        )
        cofactor, J = cofactors(F)
        smallest = min(smallest, J)
        volume, mu, lam = volumes[t], mus[t], lams[t]
        pressure = lam * natural_log(J) - mu
        inverse_transpose = scale_matrix(1.0 / J, cofactor)
        h = (
            apply_columns(inverse_transpose, g[0]),
            apply_columns(inverse_transpose, g[1]),
            apply_columns(inverse_transpose, g[2]),
            apply_columns(inverse_transpose, g[3]),
        )
        for a in range(4):
            add_to_row(gradient, nodes[t, a], nodal_gradient(volume, mu, pressure, apply_columns(F, g[a]), h[a]))
        if matrix == NO_MATRIX:
            continue
        inverse_b = outer_square(inverse_transpose)
        for a in range(4):
            for b in range(a, 4):
                if not _acts(elastic, workspace, t, a, b):
                    continue
                gg = dot(g[a], g[b])
                if matrix == PROJECTED_MATRIX:
                    block = projected_stiffness_block(volume, mu, lam, pressure, gg, h[a], h[b], inverse_b)
                else:
                    block = stiffness_block(volume, mu, lam, pressure, gg, h[a], h[b])
                _add_corners(elastic, t, a, b, block, prescribed_move, workspace)
    return smallest


@kernel
def _rest_gradients(gradients: FloatArray, t: int) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    g1 = gradients[t, 1, 0], gradients[t, 1, 1], gradients[t, 1, 2]
    g2 = gradients[t, 2, 0], gradients[t, 2, 1], gradients[t, 2, 2]
    g3 = gradients[t, 3, 0], gradients[t, 3, 1], gradients[t, 3, 2]
    return scale(-1.0, add(add(g1, g2), g3)), g1, g2, g3


@kernel
def _acts(elastic: Elastic, workspace: Workspace, t: int, a: int, b: int) -> bool:
    """Whether the block of two corners goes anywhere."""
    return bool(elastic.places[t, 4 * a + b] >= 0 or (workspace.moves[0] and elastic.reaction[t, 4 * a + b]))


@kernel
def _add_corners(
    elastic: Elastic, t: int, a: int, b: int, block: Mat3, prescribed_move: FloatArray, workspace: Workspace
) -> None:
    """Add the block of two corners to the system, or to the coupling where one of them is prescribed."""
    place, mirrored = elastic.places[t, 4 * a + b], elastic.places[t, 4 * b + a]
    if place >= 0:
        add_block(workspace.entries, place, GEL_STRIDE, block)
        if b > a:
            add_block(workspace.entries, mirrored, GEL_STRIDE, transpose(block))
    else:
        m, n = elastic.nodes[t, a], elastic.nodes[t, b]
        add_to_row(workspace.coupling, m, apply_rows(block, load(prescribed_move, n)))
        add_to_row(workspace.coupling, n, apply_columns(block, load(prescribed_move, m)))
