"""How far tetrahedra are stretched, which is what tears an elastomer: a measure of damage to a gel."""

from math import ceil

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


def measure_stretches(elastic: Elastic, x: FloatArray) -> tuple[float, float]:
    """Return the largest principal stretch of all tetrahedra at nodes x [m], and the one that 95 % do not exceed."""
    stretches = np.empty(len(elastic.volume_m3))
    write_stretches(elastic, x, stretches)
    high = ceil(_HIGH * len(stretches)) - 1
    stretches.partition(high)
    return float(stretches[high:].max()), float(stretches[high])


@large_kernel
def write_stretches(elastic: Elastic, x: FloatArray, stretches: FloatArray) -> None:
    """Write the largest principal stretch of each tetrahedron, shape [t], at nodes x [m] of shape [n, 3]."""
    nodes, gradients = elastic.nodes, elastic.gradients_1_m
    for t in range(len(stretches)):
        corners = (load(x, nodes[t, 0]), load(x, nodes[t, 1]), load(x, nodes[t, 2]), load(x, nodes[t, 3]))
        g1, g2, g3 = load(gradients[t], 1), load(gradients[t], 2), load(gradients[t], 3)
        stretches[t] = largest_stretch(deformation_gradient(corners, (g1, g1, g2, g3)))


@kernel
def largest_stretch(F: Mat3) -> float:
    """Return the largest principal stretch, the root of the largest eigenvalue of C = F^T F; F by its columns.

    With q = tr C / 3 and p^2 = tr (C - q I)^2 / 6 the eigenvalue is q + p t, t the largest root of t^3 - 3 t = r,
    r = det((C - q I) / p), which is 2 cos(arccos(r / 2) / 3) (Smith, Eigenvalues of a symmetric 3 x 3 matrix, CACM 4
    (1961) 168). Newton's method falls from t = 2 onto it with exactly rounded operations only, which an arc cosine has
    not.
    """
    a, b, c = dot(F[0], F[0]), dot(F[1], F[1]), dot(F[2], F[2])
    d, e, f = dot(F[0], F[1]), dot(F[1], F[2]), dot(F[0], F[2])
    q = (a + b + c) / 3.0
    a, b, c = a - q, b - q, c - q
    p = np.sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0)
    if p <= 1e-15 * q:
        return float(np.sqrt(q))
    r = (a * (b * c - e * e) - d * (d * c - e * f) + f * (d * e - b * f)) / (p * p * p)
    t = 2.0
    for _ in range(_ITERATIONS):
        slope = 3.0 * (t * t - 1.0)
        move = (t * (t * t - 3.0) - r) / slope if slope > 0.0 else 0.0
        if not move > 1e-15:
            break
        t -= move
    return float(np.sqrt(q + p * max(t, 1.0)))
