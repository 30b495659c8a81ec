"""Elastic forces and blocks of all tetrahedra, and how far they are stretched."""

from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..algebra import Mat3, add_to_row, apply_columns, apply_rows, dot, load, transpose
from ..linear.system import GEL_STRIDE, add_block
from ..model.model import NO_MATRIX, PROJECTED_MATRIX, Elastic, Hexahedra, NewtonSystem, get_mode
from .batch import BATCH, ROWS, deformation_gradient, get_number, get_vector, new_batch, set_number, set_vector
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


# Part of the elements that are stretched by no more than the high stretch.
_HIGH = 0.95
# Newton's iterations for the root; the slowest case, a double root, halves its error in each.
_ITERATIONS = 60
# Of these, how many are made for all elements at once.
_SHARED_ITERATIONS = 6


def measure_stretches(elastic: Elastic, hexahedra: Hexahedra, x: FloatArray) -> tuple[float, float]:
    """Return the largest principal stretch of all elements at nodes x [m], and the one that 95 % do not exceed."""
    stretches, *scratch = np.empty((4, len(elastic.volume_m3) + len(hexahedra.volume_m3)))
    write_stretches(elastic, hexahedra, x, stretches, Cubics(*scratch))
    high = ceil(_HIGH * len(stretches)) - 1
    stretches.partition(high)
    return float(stretches[high:].max()), float(stretches[high])


class Cubics(NamedTuple):
    """For each element, shapes [t], the largest eigenvalue of C = F^T F as q + p t, t the largest root of a cubic.

    With q = tr C / 3 and p^2 = tr (C - q I)^2 / 6 the cubic is t^3 - 3 t = r, r = det((C - q I) / p), and its root is
    2 cos(arccos(r / 2) / 3) (Smith, Eigenvalues of a symmetric 3 x 3 matrix, CACM 4 (1961) 168). Newton's method falls
    from t = 2 onto it with exactly rounded operations only, which an arc cosine has not.
    """

    q: FloatArray
    p: FloatArray
    r: FloatArray


@large_kernel
def write_stretches(
    elastic: Elastic, hexahedra: Hexahedra, x: FloatArray, stretches: FloatArray, cubics: Cubics
) -> None:
    """Write the largest principal stretch of each tetrahedron, then hexahedron, shape [t]; nodes x [m], [n, 3].

    The first iterations are made for all of them at once, which LLVM vectorises; few elements need more.
    """
    nodes, gradients = elastic.nodes, elastic.gradients_1_m
    tetrahedra = len(elastic.volume_m3)
    for t in range(tetrahedra):
        corners = (load(x, nodes[t, 0]), load(x, nodes[t, 1]), load(x, nodes[t, 2]), load(x, nodes[t, 3]))
        g1, g2, g3 = load(gradients[t], 1), load(gradients[t], 2), load(gradients[t], 3)
        cubics.q[t], cubics.p[t], cubics.r[t] = _cubic(deformation_gradient(corners, (g1, g1, g2, g3)))
    for h in range(len(hexahedra.volume_m3)):
        F = get_mode(hexahedra, h, 0, x), get_mode(hexahedra, h, 1, x), get_mode(hexahedra, h, 2, x)
        t = tetrahedra + h
        cubics.q[t], cubics.p[t], cubics.r[t] = _cubic(F)
    for t in range(len(stretches)):
        stretches[t] = 2.0
    for _ in range(_SHARED_ITERATIONS):
        for t in range(len(stretches)):
            stretches[t] -= _fall(stretches[t], cubics.r[t])
    for t in range(len(stretches)):
        root = _root(stretches[t], cubics.r[t], _ITERATIONS - _SHARED_ITERATIONS)
        stretches[t] = _stretch(cubics.q[t], cubics.p[t], root)


@kernel
def largest_stretch(F: Mat3) -> float:
    """Return the largest principal stretch; F by its columns."""
    q, p, r = _cubic(F)
    return _stretch(q, p, _root(2.0, r, _ITERATIONS))


@kernel
def _cubic(F: Mat3) -> tuple[float, float, float]:
    """Return q, p and r of `Cubics`; of equal eigenvalues p = 0 and r = 2."""
    a, b, c = dot(F[0], F[0]), dot(F[1], F[1]), dot(F[2], F[2])
    d, e, f = dot(F[0], F[1]), dot(F[1], F[2]), dot(F[0], F[2])
    q = (a + b + c) / 3.0
    a, b, c = a - q, b - q, c - q
    p = np.sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0)
    if p <= 1e-15 * q:
        return q, 0.0, 2.0
    return q, p, (a * (b * c - e * e) - d * (d * c - e * f) + f * (d * e - b * f)) / (p * p * p)


@kernel
def _fall(t: float, r: float) -> float:
    """Return Newton's move from t down towards the root, 0 once it is there."""
    slope = 3.0 * (t * t - 1.0)
    move = (t * (t * t - 3.0) - r) / slope if slope > 0.0 else 0.0
    return move if move > 1e-15 else 0.0


@kernel
def _root(t: float, r: float, iterations: int) -> float:
    for _ in range(iterations):
        move = _fall(t, r)
        if move == 0.0:
            break
        t -= move
    return t


@kernel
def _stretch(q: float, p: float, t: float) -> float:
    return float(np.sqrt(q + p * max(t, 1.0)))
