"""Places spread evenly over the faces of a gel, for sums over their area."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Each triangle is cut into the square of this many equal ones; a place is the centre of one.
_PARTS = 4


class FacePlaces(NamedTuple):
    """Places on triangles.

    Attributes:
        corners: of the triangle of each place, shape [q, 3].
        weights: barycentric, shape [q, 3].
        areas_m2: of the part of the faces that each place stands for [m2], shape [q].
    """

    corners: IndexArray
    weights: FloatArray
    areas_m2: FloatArray

    def select(self, chosen: NDArray[np.bool_]) -> "FacePlaces":
        """Return some of the places."""
        return FacePlaces(self.corners[chosen], self.weights[chosen], self.areas_m2[chosen])


def places_on_faces(positions_m: FloatArray, triangles: IndexArray) -> FacePlaces:
    """Return 16 places on each triangle.

    Args:
        positions_m: of nodes [m], shape [n, 3].
        triangles: numbers of nodes, shape [f, 3].
    """
    inner = np.array(
        [
            ((3 * i + 1 + up) / (3 * _PARTS), (3 * j + 1 + up) / (3 * _PARTS))
            for up in (0, 1)
            for i in range(_PARTS)
            for j in range(_PARTS - i - up)
        ]
    )
    weights = np.column_stack([1.0 - inner.sum(axis=1), inner])
    corners_m = positions_m[triangles]
    normals = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    areas_m2 = 0.5 * np.sqrt((normals * normals).sum(axis=1)) / len(weights)
    return FacePlaces(
        corners=np.repeat(triangles, len(weights), axis=0),
        weights=np.tile(weights, (len(triangles), 1)),
        areas_m2=np.repeat(areas_m2, len(weights)),
    )
