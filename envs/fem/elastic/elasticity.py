"""Elastic forces and stiffness of all gels: the material of `neo_hookean`, summed over tetrahedra.

Another material is a module with the functions of `neo_hookean` that are imported here, and its parameters in
`model.Elastic`.
"""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ...deterministic_math import natural_log
from ..algebra.mat3 import Mat3, apply_columns, apply_rows, outer_square, scale_matrix, transpose
from ..algebra.vec3 import Vec3, add, add_to_row, dot, load, scale
from ..linear.system import GEL_STRIDE, add_block
from ..model.model import Elastic
from ..solver.workspace import NO_MATRIX, PROJECTED_MATRIX, Workspace
from .batch import (
    BATCH,
    DET_F,
    FORCE,
    GRADIENT,
    INVERSE_TRANSPOSE,
    LAMBDA,
    MU,
    POSITION,
    PRESSURE,
    REST_GRADIENT,
    VOLUME,
    get_number,
    get_vector,
    set_number,
    set_vector,
)
from .neo_hookean import cofactors, deformation_gradient, nodal_gradient, projected_stiffness_block, stiffness_block

FloatArray = NDArray[np.float64]


@large_kernel
def add_elasticity(
    elastic: Elastic, x: FloatArray, prescribed_move: FloatArray, workspace: Workspace, matrix: int
) -> float:
    """Add all tetrahedra at nodes x [m]; returns the smallest det F.

    Prescribed corners, which move by prescribed_move [m], are added to the coupling where they act on unknown ones.
    """
    gradient, batch = workspace.gradient, workspace.batch
    total = len(elastic.volume_m3)
    smallest = np.inf
    for start in range(0, total, BATCH):
        count = min(BATCH, total - start)
        for i in range(count):
            _collect(elastic, start + i, x, batch, i)
        # A last batch is computed whole, for a loop of known length; nothing takes what it has too many.
        for i in range(BATCH):
            _strain(batch, i)
        for i in range(count):
            smallest = min(smallest, get_number(batch, DET_F, i))
            for a in range(4):
                add_to_row(gradient, elastic.nodes[start + i, a], get_vector(batch, FORCE, a, i))
            if matrix != NO_MATRIX:
                _add_stiffness(elastic, start + i, batch, i, prescribed_move, workspace, matrix)
    return smallest


@kernel
def _collect(elastic: Elastic, t: int, x: FloatArray, batch: FloatArray, i: int) -> None:
    """Write what is given of tetrahedron t at place i of the batch."""
    for a in range(4):
        set_vector(batch, POSITION, a, i, load(x, elastic.nodes[t, a]))
    gradients = elastic.gradients_1_m
    for a in range(1, 4):
        set_vector(batch, REST_GRADIENT, a - 1, i, (gradients[t, a, 0], gradients[t, a, 1], gradients[t, a, 2]))
    set_number(batch, VOLUME, i, elastic.volume_m3[t])
    set_number(batch, MU, i, elastic.mu_pa[t])
    set_number(batch, LAMBDA, i, elastic.lambda_pa[t])


@kernel
def _strain(batch: FloatArray, i: int) -> None:
    """Write what follows from the positions of tetrahedron i of the batch; without branches, for vectors."""
    x0, x1 = get_vector(batch, POSITION, 0, i), get_vector(batch, POSITION, 1, i)
    x2, x3 = get_vector(batch, POSITION, 2, i), get_vector(batch, POSITION, 3, i)
    g = _rest_gradients(batch, i)
    F = deformation_gradient(x0, x1, x2, x3, g[1], g[2], g[3])
    cofactor, J = cofactors(F)
    volume, mu = get_number(batch, VOLUME, i), get_number(batch, MU, i)
    pressure = get_number(batch, LAMBDA, i) * natural_log(J) - mu
    inverse_transpose = scale_matrix(1.0 / J, cofactor)
    set_number(batch, DET_F, i, J)
    set_number(batch, PRESSURE, i, pressure)
    for k in range(3):
        set_vector(batch, INVERSE_TRANSPOSE, k, i, inverse_transpose[k])
    for a in range(4):
        h = apply_columns(inverse_transpose, g[a])
        set_vector(batch, GRADIENT, a, i, h)
        set_vector(batch, FORCE, a, i, nodal_gradient(volume, mu, pressure, apply_columns(F, g[a]), h))


@kernel
def _add_stiffness(
    elastic: Elastic,
    t: int,
    batch: FloatArray,
    i: int,
    prescribed_move: FloatArray,
    workspace: Workspace,
    matrix: int,
) -> None:
    """Add the blocks of tetrahedron t, which stands at place i of the batch."""
    volume, mu, lam = get_number(batch, VOLUME, i), get_number(batch, MU, i), get_number(batch, LAMBDA, i)
    pressure = get_number(batch, PRESSURE, i)
    g = _rest_gradients(batch, i)
    h = (
        get_vector(batch, GRADIENT, 0, i),
        get_vector(batch, GRADIENT, 1, i),
        get_vector(batch, GRADIENT, 2, i),
        get_vector(batch, GRADIENT, 3, i),
    )
    inverse_b = outer_square(
        (
            get_vector(batch, INVERSE_TRANSPOSE, 0, i),
            get_vector(batch, INVERSE_TRANSPOSE, 1, i),
            get_vector(batch, INVERSE_TRANSPOSE, 2, i),
        )
    )
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


@kernel
def _rest_gradients(batch: FloatArray, i: int) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    g1, g2, g3 = (
        get_vector(batch, REST_GRADIENT, 0, i),
        get_vector(batch, REST_GRADIENT, 1, i),
        get_vector(batch, REST_GRADIENT, 2, i),
    )
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
