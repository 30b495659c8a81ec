"""Tetrahedra of a gel before anything is said about them: volume, boundary, quality and bytes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .surface import DrawnSurface

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# Nodes of the base are within this of its plane.
BASE_PLANE_MM = 1e-3
# Outward faces of a positively oriented tetrahedron.
_FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))
_EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


@dataclass(frozen=True, kw_only=True, eq=False)
class Tetrahedra:
    """A tetrahedral mesh in millimetres, as it was made or read.

    Attributes:
        nodes_mm: node positions, shape [n, 3].
        corners: node indices, shape [t, 4].
    """

    nodes_mm: FloatArray
    corners: IndexArray

    @cached_property
    def volumes_mm3(self) -> FloatArray:
        """Volumes [mm3], shape [t]; negative where a tetrahedron is inverted."""
        points = self.nodes_mm[self.corners]
        a, b, c = (points[:, k] - points[:, 0] for k in (1, 2, 3))
        return np.asarray((np.cross(a, b) * c).sum(axis=1) / 6.0)

    @property
    def volume_mm3(self) -> float:
        """Sum of the volumes [mm3]."""
        return float(self.volumes_mm3.sum())

    @cached_property
    def qualities(self) -> FloatArray:
        """Return 6 sqrt(2) V / (longest edge)^3, shape [t]: 1 for a regular tetrahedron, 0 for a flat one."""
        points = self.nodes_mm[self.corners]
        sides = np.stack([points[:, i] - points[:, j] for i, j in _EDGES], axis=1)
        longest = np.sqrt((sides * sides).sum(axis=2).max(axis=1))
        return np.asarray(6.0 * np.sqrt(2.0) * self.volumes_mm3 / (longest * longest * longest))

    @cached_property
    def n_shared_faces(self) -> int:
        """Faces that more than two tetrahedra have."""
        return int((self._face_uses > 2).sum())

    @cached_property
    def surface(self) -> DrawnSurface:
        """Faces of a single tetrahedron, outward."""
        first = self._first_face[self._face_uses == 1]
        return DrawnSurface(vertices_mm=self.nodes_mm, triangles=self._faces[np.sort(first)])

    @cached_property
    def base_faces(self) -> NDArray[np.bool_]:
        """Whether each triangle of `surface` lies in the plane of the base and looks down, shape [f]."""
        surface = self.surface
        is_low = (surface.corners_mm[:, :, 2] <= BASE_PLANE_MM).all(axis=1)
        return np.asarray(is_low & (surface.area_vectors_mm2[:, 2] < 0.0))

    def as_bytes(self) -> bytes:
        """Return positions and corners in a fixed order and byte order, for digests."""
        return self.nodes_mm.astype("<f8").tobytes() + self.corners.astype("<i8").tobytes()

    @cached_property
    def _faces(self) -> IndexArray:
        return np.asarray(self.corners[:, _FACES].reshape(-1, 3))

    @cached_property
    def _counted(self) -> tuple[IndexArray, IndexArray]:
        _, first, counts = np.unique(np.sort(self._faces, axis=1), axis=0, return_index=True, return_counts=True)
        return first, counts

    @property
    def _first_face(self) -> IndexArray:
        return self._counted[0]

    @property
    def _face_uses(self) -> IndexArray:
        return self._counted[1]
