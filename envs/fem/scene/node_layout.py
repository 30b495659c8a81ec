"""Where the bodies of a scene stand in its node array, and where their nodes are at the start."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..affine.affine_body import frame_weights
from ..model.bodies import GelBody, RigidBody

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NodeLayout:
    """Where the bodies' nodes stand in the scene's node array."""

    gels: tuple[GelBody, ...]
    bodies: tuple[RigidBody, ...]
    gel_slices: list[slice] = field(init=False, default_factory=list)
    body_slices: list[slice] = field(init=False, default_factory=list)
    body_weights: list[FloatArray] = field(init=False, default_factory=list)
    body_centroids_m: list[FloatArray] = field(init=False, default_factory=list)
    body_lengths_m: list[float] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        count = 0
        for gel in self.gels:
            self.gel_slices.append(slice(count, count + len(gel.mesh.rest_position_m)))
            count += len(gel.mesh.rest_position_m)
        for body in self.bodies:
            volume, first, _ = body.mesh.moments
            centroid = first / volume
            length = float(np.abs(body.mesh.vertices_m - centroid).max())
            self.body_slices.append(slice(count, count + 4))
            self.body_centroids_m.append(centroid)
            self.body_lengths_m.append(length)
            self.body_weights.append(frame_weights(body.mesh.vertices_m, centroid, length))
            count += 4

    def initial_positions_m(self) -> FloatArray:
        """Return the node positions [m] of shape [n, 3] as the bodies were placed."""
        parts = [placed(gel.mesh.rest_position_m, gel) for gel in self.gels]
        for body, centroid, length in zip(self.bodies, self.body_centroids_m, self.body_lengths_m, strict=True):
            frame = centroid + length * np.concatenate([np.zeros((1, 3)), np.eye(3)])
            parts.append(placed(frame, body))
        return np.concatenate(parts)


def placed(points_m: FloatArray, body: GelBody | RigidBody) -> FloatArray:
    """Return the points in the world: rotation @ point + translation, without BLAS."""
    return np.asarray((body.rotation[None, :, :] * points_m[:, None, :]).sum(axis=2) + body.translation_m)
