"""A triangle surface as somebody drew it, which may be anything, and the counts that show what is wrong with it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .sampling import samples_mm

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_NO_HEIGHT_MM = 1e-5
"""Single precision, in which STL files have their coordinates, rounds those of a gel to some 1e-6 mm."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DrawnSurface:
    """Triangles between numbered vertices; unlike `SurfaceMesh` neither closed nor oriented nor in metres.

    Attributes:
        vertices_mm: shape [v, 3].
        triangles: vertex indices, shape [f, 3]; no triangle names a vertex twice.
    """

    vertices_mm: FloatArray
    triangles: IndexArray

    @classmethod
    def from_corners(cls, corners_mm: FloatArray) -> "DrawnSurface":
        """Return the surface of triangles with corners of shape [f, 3, 3]; equal positions become one vertex.

        Triangles two of whose corners are one vertex are left away, and vertices that no other triangle has. Where a
        triangle without height closes a T-junction, as CAD kernels write it, its neighbour is divided instead, which
        leaves the shape as it is.
        """
        vertices, index = np.unique(corners_mm.reshape(-1, 3), axis=0, return_inverse=True)
        triangles = index.reshape(-1, 3).astype(np.int64)
        a, b, c = triangles.T
        used, kept = np.unique(triangles[(a != b) & (b != c) & (c != a)], return_inverse=True)
        whole = kept.reshape(-1, 3).astype(np.int64)
        return cls(vertices_mm=vertices[used], triangles=_divided_at_t_junctions(vertices[used], whole))

    @cached_property
    def corners_mm(self) -> FloatArray:
        """Corners of the triangles [mm], shape [f, 3, 3]."""
        return self.vertices_mm[self.triangles]

    @cached_property
    def samples_mm(self) -> FloatArray:
        """Points of the surface, corners included, about 0.5 mm apart [mm], shape [n, 3]."""
        return samples_mm(self.corners_mm)

    @cached_property
    def area_vectors_mm2(self) -> FloatArray:
        """Outward normals of the triangles with the length of their areas [mm2], shape [f, 3]."""
        corners = self.corners_mm
        return np.asarray(0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))

    @cached_property
    def areas_mm2(self) -> FloatArray:
        """Areas of the triangles [mm2], shape [f]."""
        return np.asarray(np.sqrt((self.area_vectors_mm2**2).sum(axis=1)))

    @cached_property
    def extent_mm(self) -> FloatArray:
        """Extent along x, y and z [mm], shape [3]."""
        return np.asarray(self.vertices_mm.max(axis=0) - self.vertices_mm.min(axis=0))

    @cached_property
    def volume_mm3(self) -> float:
        """Enclosed volume [mm3]; negative where the triangles are clockwise seen from outside."""
        return float(self._signed_volumes_mm3.sum())

    @cached_property
    def edges(self) -> IndexArray:
        """Undirected edges, each once, shape [e, 2]."""
        return self._edges[0]

    @property
    def n_open_edges(self) -> int:
        """Edges of a single triangle."""
        return int((self._uses.sum(axis=1) == 1).sum())

    @property
    def n_mixed_edges(self) -> int:
        """Edges at which two triangles meet that are oriented against each other."""
        return int(((self._uses == 2) & (self._uses[:, ::-1] == 0)).any(axis=1).sum())

    @property
    def n_branching_edges(self) -> int:
        """Edges at which more than two triangles meet."""
        return int((self._uses.sum(axis=1) > 2).sum())

    @cached_property
    def triangles_of_edges(self) -> IndexArray:
        """The two triangles at every edge of a surface on which exactly two meet at each, shape [e, 2]."""
        _, inverse, _ = self._edges
        order = np.argsort(inverse, kind="stable")
        return (order % len(self.triangles)).reshape(-1, 2)

    @cached_property
    def shells(self) -> IndexArray:
        """Number of the connected part that each triangle belongs to, from 0, shape [f]; parts share no edge."""
        label = np.arange(len(self.triangles))
        _, inverse, count = self._edges
        owner = np.tile(label, 3)
        while True:
            lowest = np.full(count, len(self.triangles))
            np.minimum.at(lowest, inverse, label[owner])
            smaller = label.copy()
            np.minimum.at(smaller, owner, lowest[inverse])
            smaller = smaller[smaller]
            if (smaller == label).all():
                return np.unique(label, return_inverse=True)[1].astype(np.int64)
            label = smaller

    def shell_volumes_mm3(self) -> FloatArray:
        """Return the enclosed volume of every shell [mm3], shape [s]."""
        return np.bincount(self.shells, weights=self._signed_volumes_mm3).astype(np.float64)

    @cached_property
    def _signed_volumes_mm3(self) -> FloatArray:
        # From the middle of the box: far from the origin the terms would cancel.
        corners = self.corners_mm - 0.5 * (self.vertices_mm.max(axis=0) + self.vertices_mm.min(axis=0))
        return np.asarray((np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]).sum(axis=1) / 6.0)

    @cached_property
    def _edges(self) -> tuple[IndexArray, IndexArray, int]:
        """Undirected edges, the edge of each directed one (first all of corner 0, then 1, then 2), and their number."""
        directed = self._directed
        key = directed.min(axis=1) * len(self.vertices_mm) + directed.max(axis=1)
        unique, inverse = np.unique(key, return_inverse=True)
        edges = np.column_stack(np.divmod(unique, len(self.vertices_mm)))
        return edges.astype(np.int64), inverse.reshape(-1).astype(np.int64), len(unique)

    @cached_property
    def _directed(self) -> IndexArray:
        return np.concatenate([self.triangles[:, [i, (i + 1) % 3]] for i in range(3)])

    @cached_property
    def _uses(self) -> IndexArray:
        """How often every edge is used upwards and downwards in vertex index, shape [e, 2]."""
        _, inverse, count = self._edges
        upward = self._directed[:, 0] < self._directed[:, 1]
        return np.column_stack([np.bincount(inverse[way], minlength=count) for way in (upward, ~upward)])


def _divided_at_t_junctions(vertices_mm: FloatArray, triangles: IndexArray) -> IndexArray:
    """Return the triangles with the longest edge of each one without height flipped, until none is left that can be.

    Of the triangle b, a, m with m on the edge from a to b, and its neighbour a, b, c, become a, m, c and m, b, c.
    """
    found = triangles.copy()
    while True:
        corners = vertices_mm[found]
        edges = np.roll(corners, -1, axis=1) - corners  # from each corner on
        lengths = np.sqrt((edges**2).sum(axis=2))
        areas = np.sqrt((np.cross(edges[:, 0], edges[:, 1]) ** 2).sum(axis=1))
        flat = np.flatnonzero(areas <= _NO_HEIGHT_MM * lengths.max(axis=1))
        if not len(flat):
            return found
        owner = {(int(t[i]), int(t[(i + 1) % 3])): n for n, t in enumerate(found) for i in range(3)}
        without_height, changed = set(flat.tolist()), set[int]()
        for n in flat.tolist():
            i = int(lengths[n].argmax())
            b, a, m = (int(found[n, (i + k) % 3]) for k in range(3))
            neighbour = owner.get((a, b))
            if neighbour is None or neighbour in without_height or neighbour in changed:
                continue
            c = next(int(corner) for corner in found[neighbour] if corner not in (a, b))
            if c == m:
                continue
            found[n], found[neighbour] = (a, m, c), (m, b, c)
            changed |= {n, neighbour}
        if not changed:
            return found
