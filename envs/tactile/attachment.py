"""Where markers of a sensor's design sit: on the face that the camera's ray leaves the undeformed gel by."""

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compilation import allocating_kernel
from ..fem.algebra.vec3 import Vec3, cross, dot, load, subtract

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# A face whose normal has a smaller cosine with the ray is seen edge-on.
_EDGE_ON_COSINE = 0.05
# Weights may be this much below 0, so that no marker falls between two triangles.
_WEIGHT_TOLERANCE = 1e-9


class Fault(IntEnum):
    """Why a marker cannot be where it is drawn."""

    NONE = 0
    """The marker can be attached."""
    OFF_THE_GEL = 1
    """The camera's ray through it misses the gel."""
    NOT_ON_SENSING_FACE = 2
    """The ray leaves the gel through a wall or through another face that does not sense."""
    EDGE_ON = 3
    """The face is seen edge-on."""
    OUT_OF_PICTURE = 4
    """The marker is outside the camera's picture."""


class Attachment(NamedTuple):
    """Markers on triangles.

    Attributes:
        triangles: index of each marker's triangle, shape [m]; -1 where the ray misses.
        weights: barycentric, 0 to 1, shape [m, 3].
        faults: `Fault` of each marker, shape [m].
    """

    triangles: IndexArray
    weights: FloatArray
    faults: IndexArray


@allocating_kernel
def attach_along_rays(
    eye: Vec3, through: FloatArray, vertices: FloatArray, triangles: IndexArray, senses: NDArray[np.bool_]
) -> Attachment:
    """Return where rays first leave a closed body.

    Args:
        eye: where all rays begin, outside of the body.
        through: a point on each ray, shape [m, 3].
        vertices: of the body's surface, shape [v, 3].
        triangles: outward, shape [f, 3].
        senses: whether a triangle may carry markers, shape [f].
    """
    chosen = np.full(len(through), -1, dtype=np.int64)
    weights = np.zeros((len(through), 3))
    faults = np.full(len(through), 1, dtype=np.int64)
    for m in range(len(through)):
        ray = subtract(load(through, m), eye)
        nearest = np.inf
        for t in range(len(triangles)):
            a = subtract(load(vertices, triangles[t, 0]), eye)
            b = subtract(load(vertices, triangles[t, 1]), eye)
            c = subtract(load(vertices, triangles[t, 2]), eye)
            normal = cross(subtract(b, a), subtract(c, a))
            along = dot(normal, ray)
            if along <= 0.0:
                continue
            # Volumes of the tetrahedra between the ray and the edges opposite to each corner.
            w0, w1, w2 = dot(ray, cross(b, c)), dot(ray, cross(c, a)), dot(ray, cross(a, b))
            total = w0 + w1 + w2
            least = -_WEIGHT_TOLERANCE * total
            if total <= 0.0 or w0 < least or w1 < least or w2 < least:
                continue
            distance = dot(normal, a) / along
            if distance < nearest:
                nearest = distance
                chosen[m] = t
                w0, w1, w2 = max(w0, 0.0), max(w1, 0.0), max(w2, 0.0)
                total = w0 + w1 + w2
                weights[m, 0], weights[m, 1], weights[m, 2] = w0 / total, w1 / total, w2 / total
                edge_on = along < _EDGE_ON_COSINE * np.sqrt(dot(normal, normal) * dot(ray, ray))
                faults[m] = 2 if not senses[t] else 3 if edge_on else 0
    return Attachment(chosen, weights, faults)
