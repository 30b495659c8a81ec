"""How far tetrahedra are stretched, which is what tears an elastomer: a measure of damage to a gel."""

from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel, large_kernel
from ..algebra.mat3 import Mat3
from ..algebra.vec3 import dot, load
from ..model.model import Elastic
from .deformation import deformation_gradient

FloatArray = NDArray[np.float64]

# Part of the tetrahedra that are stretched by no more than the high stretch.
_HIGH = 0.95
# Newton's iterations for the root; the slowest case, a double root, halves its error in each.
_ITERATIONS = 60
# Of these, how many are made for all tetrahedra at once.
_SHARED_ITERATIONS = 6


def measure_stretches(elastic: Elastic, x: FloatArray) -> tuple[float, float]:
    """Return the largest principal stretch of all tetrahedra at nodes x [m], and the one that 95 % do not exceed."""
    stretches, *scratch = np.empty((4, len(elastic.volume_m3)))
    write_stretches(elastic, x, stretches, Cubics(*scratch))
    high = ceil(_HIGH * len(stretches)) - 1
    stretches.partition(high)
    return float(stretches[high:].max()), float(stretches[high])


class Cubics(NamedTuple):
    """For each tetrahedron, shapes [t], the largest eigenvalue of C = F^T F as q + p t, t the largest root of a cubic.

    With q = tr C / 3 and p^2 = tr (C - q I)^2 / 6 the cubic is t^3 - 3 t = r, r = det((C - q I) / p), and its root is
    2 cos(arccos(r / 2) / 3) (Smith, Eigenvalues of a symmetric 3 x 3 matrix, CACM 4 (1961) 168). Newton's method falls
    from t = 2 onto it with exactly rounded operations only, which an arc cosine has not.
    """

    q: FloatArray
    p: FloatArray
    r: FloatArray


@large_kernel
def write_stretches(elastic: Elastic, x: FloatArray, stretches: FloatArray, cubics: Cubics) -> None:
    """Write the largest principal stretch of each tetrahedron, shape [t], at nodes x [m] of shape [n, 3].

    The first iterations are made for all of them at once, which LLVM vectorises; few tetrahedra need more.
    """
    nodes, gradients = elastic.nodes, elastic.gradients_1_m
    for t in range(len(stretches)):
        corners = (load(x, nodes[t, 0]), load(x, nodes[t, 1]), load(x, nodes[t, 2]), load(x, nodes[t, 3]))
        g1, g2, g3 = load(gradients[t], 1), load(gradients[t], 2), load(gradients[t], 3)
        cubics.q[t], cubics.p[t], cubics.r[t] = _cubic(deformation_gradient(corners, (g1, g1, g2, g3)))
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
