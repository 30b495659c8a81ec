"""Elastic forces and stiffness of all gels: a material, summed over tetrahedra.

Another material is a module with what is imported from `neo_hookean` here, and this import changed; a test does both
for St. Venant and Kirchhoff's.
"""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..algebra.mat3 import Mat3, apply_columns, apply_rows, transpose
from ..algebra.vec3 import add_to_row, load
from ..linear.system import GEL_STRIDE, add_block
from ..model.model import Elastic
from ..model.newton_system import NO_MATRIX, PROJECTED_MATRIX, NewtonSystem
from .batch import BATCH, ROWS, get_number, get_vector, new_batch, set_number, set_vector
from .neo_hookean import BATCH_ROWS, projected_stiffness_block, stiffness_block, strained, write_forces

FloatArray = NDArray[np.float64]


def new_elastic_batch() -> FloatArray:
    """Return uninitialised scratch for `add_elasticity`."""
    return new_batch(BATCH_ROWS)


@large_kernel
def add_elasticity(elastic: Elastic, x: FloatArray, batch: FloatArray, system: NewtonSystem, matrix: int) -> float:
    """Add all tetrahedra at nodes x [m]; return the smallest det F.

    Prescribed corners, which move by the system's prescribed motion, are added to the coupling where they act on
    unknown ones.
    """
    total = len(elastic.volume_m3)
    smallest = np.inf
    for start in range(0, total, BATCH):
        count = min(BATCH, total - start)
        for i in range(count):
            _collect(elastic, start + i, x, batch, i)
        # A last batch is computed whole, for a loop of known length; nothing takes what it has too many.
        for i in range(BATCH):
            write_forces(batch, i)
        for i in range(count):
            smallest = min(smallest, get_number(batch, ROWS.det_f, i))
            for a in range(4):
                add_to_row(system.gradient, elastic.nodes[start + i, a], get_vector(batch, ROWS.force, a, i))
            if matrix != NO_MATRIX:
                _add_stiffness(elastic, start + i, batch, i, system, matrix)
    return smallest


@kernel
def _collect(elastic: Elastic, t: int, x: FloatArray, batch: FloatArray, i: int) -> None:
    """Write what is given of tetrahedron t at place i of the batch."""
    for a in range(4):
        set_vector(batch, ROWS.position, a, i, load(x, elastic.nodes[t, a]))
    gradients = elastic.gradients_1_m
    for a in range(1, 4):
        set_vector(batch, ROWS.rest_gradient, a - 1, i, (gradients[t, a, 0], gradients[t, a, 1], gradients[t, a, 2]))
    set_number(batch, ROWS.volume, i, elastic.volume_m3[t])
    set_number(batch, ROWS.mu, i, elastic.mu_pa[t])
    set_number(batch, ROWS.lam, i, elastic.lambda_pa[t])


@kernel
def _add_stiffness(elastic: Elastic, t: int, batch: FloatArray, i: int, system: NewtonSystem, matrix: int) -> None:
    """Add the blocks of tetrahedron t, which stands at place i of the batch."""
    s = strained(batch, i)
    for a in range(4):
        for b in range(a, 4):
            if not _acts(elastic, system, t, a, b):
                continue
            block = projected_stiffness_block(s, a, b) if matrix == PROJECTED_MATRIX else stiffness_block(s, a, b)
            _add_corners(elastic, t, a, b, block, system)


@kernel
def _acts(elastic: Elastic, system: NewtonSystem, t: int, a: int, b: int) -> bool:
    """Return whether the block of two corners goes anywhere."""
    return bool(elastic.places[t, 4 * a + b] >= 0 or (system.moves[0] and elastic.reaction[t, 4 * a + b]))


@kernel
def _add_corners(elastic: Elastic, t: int, a: int, b: int, block: Mat3, system: NewtonSystem) -> None:
    """Add the block of two corners to the matrix, or to the coupling where one of them is prescribed."""
    place, mirrored = elastic.places[t, 4 * a + b], elastic.places[t, 4 * b + a]
    if place >= 0:
        add_block(system.entries, place, GEL_STRIDE, block)
        if b > a:
            add_block(system.entries, mirrored, GEL_STRIDE, transpose(block))
    else:
        m, n = elastic.nodes[t, a], elastic.nodes[t, b]
        add_to_row(system.coupling, m, apply_rows(block, load(system.prescribed_move, n)))
        add_to_row(system.coupling, n, apply_columns(block, load(system.prescribed_move, m)))
