"""Positions of surface points, which gels and affine bodies derive from their nodes in different ways."""

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from .model import Points

FloatArray = NDArray[np.float64]


@kernel
def point_positions(points: Points, x: FloatArray, y: FloatArray) -> None:
    """Write positions (or displacements) of all surface points, y [p, 3], from those of the nodes, x [n, 3]."""
    nodes, weights, count = points.nodes, points.weights, points.node_count
    for p in range(len(count)):
        if count[p] == 1:
            for k in range(3):
                y[p, k] = x[nodes[p, 0], k]
        else:
            for k in range(3):
                y[p, k] = (
                    weights[p, 0] * x[nodes[p, 0], k]
                    + weights[p, 1] * x[nodes[p, 1], k]
                    + weights[p, 2] * x[nodes[p, 2], k]
                    + weights[p, 3] * x[nodes[p, 3], k]
                )
