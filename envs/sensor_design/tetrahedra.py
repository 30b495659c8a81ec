"""Tetrahedra of a gel: volume, boundary, quality and bytes; their refinement; which faces are driven, which sense."""

from collections import Counter, defaultdict
from dataclasses import dataclass
from functools import cached_property
from heapq import heapify, heappop, heappush
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..fem.model.mesh import GelMesh, MeshError
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


Edge = tuple[int, int]
Point = tuple[float, float, float]
Waiting = tuple[float, Point, Edge]


def refined(mesh: Tetrahedra, nodes: int) -> Tetrahedra:
    """Return a mesh of the same body with at least this number of nodes: its longest edges are halved one by one."""
    halving = _Halving(mesh)
    waiting = [halving.waiting(edge) for edge in halving.edges]
    heapify(waiting)
    while len(halving.points) < nodes:
        for added in halving.halve(heappop(waiting)):
            heappush(waiting, halving.waiting(added))
    return halving.mesh()


def refined_tips(mesh: Tetrahedra, *, depth_mm: float, fewest: int, max_nodes: int) -> Tetrahedra:
    """Return a mesh of the same body in which each of its highest parts has nodes enough to be flattened.

    A part is made of nodes above a plane, joined by edges above it. Of every part with too few nodes the longest edges
    that reach into it are halved, until it has enough or the mesh has reached its limit.

    Args:
        mesh: of a body; it is returned as it is where every part has nodes enough.
        depth_mm: of the plane below the highest node.
        fewest: nodes of a part.
        max_nodes: of the mesh.
    """
    plane_mm = _plane_mm(mesh, depth_mm)
    halving = _Halving(mesh)
    part_of = _parts(halving.edges, mesh.nodes_mm[:, 2] >= plane_mm)
    counts = Counter(part_of.values())
    waiting = [halving.waiting(edge) for edge in halving.edges if edge[0] in part_of or edge[1] in part_of]
    heapify(waiting)
    while waiting and len(halving.points) < max_nodes:
        first = heappop(waiting)
        part = next(part_of[end] for end in first[2] if end in part_of)
        if counts[part] >= fewest:
            continue
        new = len(halving.points)
        added = halving.halve(first)
        if halving.points[new][2] >= plane_mm:
            part_of[new] = part
            counts[part] += 1
        for edge in added:
            if edge[0] in part_of or edge[1] in part_of:
                heappush(waiting, halving.waiting(edge))
    return halving.mesh()


def tip_sizes(mesh: Tetrahedra, *, depth_mm: float) -> list[int]:
    """Return how many nodes each of the highest parts has, ascending; arguments as of `refined_tips`."""
    parts = _parts(_Halving(mesh).edges, mesh.nodes_mm[:, 2] >= _plane_mm(mesh, depth_mm))
    return sorted(Counter(parts.values()).values())


class _Halving:
    """A mesh whose edges are halved.

    Attributes:
        points: positions of the nodes [mm].
    """

    def __init__(self, mesh: Tetrahedra) -> None:
        self.points: list[Point] = [(x, y, z) for x, y, z in mesh.nodes_mm.tolist()]
        self._cells: list[list[int]] = mesh.corners.tolist()
        self._around: dict[Edge, set[int]] = defaultdict(set)
        for number, cell in enumerate(self._cells):
            for edge in _edges(cell):
                self._around[edge].add(number)

    @property
    def edges(self) -> list[Edge]:
        """All edges, smaller index first."""
        return list(self._around)

    def waiting(self, edge: Edge) -> Waiting:
        """Return an edge as it waits: longest first, then by its middle."""
        (ax, ay, az), (bx, by, bz) = self.points[edge[0]], self.points[edge[1]]
        squared = (ax - bx) * (ax - bx) + (ay - by) * (ay - by) + (az - bz) * (az - bz)
        return -squared, (0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz)), edge

    def halve(self, waiting: Waiting) -> list[Edge]:
        """Put a node on the middle of an edge; return the edges that have come with it, ascending."""
        _, middle, edge = waiting
        self.points.append(middle)
        new: set[Edge] = set()
        for number in sorted(self._around.pop(edge)):
            new |= self._halve_cell(number, edge, len(self.points) - 1)
        return sorted(new)

    def mesh(self) -> Tetrahedra:
        """Return the mesh as it is now."""
        return Tetrahedra(nodes_mm=np.array(self.points), corners=np.array(self._cells, dtype=np.int64))

    def _halve_cell(self, number: int, edge: Edge, middle: int) -> set[Edge]:
        """Put a tetrahedron's halves in its place and at the end; return the edges that have come with them."""
        whole = self._cells[number]
        first, second = ([middle if node == end else node for node in whole] for end in edge)
        self._cells[number] = first
        self._cells.append(second)
        for old in _edges(whole):
            if old != edge:
                self._around[old].discard(number)
        for index, half in ((number, first), (len(self._cells) - 1, second)):
            for own in _edges(half):
                self._around[own].add(index)
        return {own for half in (first, second) for own in _edges(half) if middle in own}


def _plane_mm(mesh: Tetrahedra, depth_mm: float) -> float:
    return float(mesh.nodes_mm[:, 2].max()) - depth_mm


def _parts(edges: list[Edge], is_high: NDArray[np.bool_]) -> dict[int, int]:
    """Return for every high node the lowest number in its part."""
    part_of = {node: node for node in np.flatnonzero(is_high).tolist()}

    def find(node: int) -> int:
        while part_of[node] != node:
            node = part_of[node]
        return node

    for a, b in edges:
        if a in part_of and b in part_of:
            first, second = find(a), find(b)
            part_of[max(first, second)] = min(first, second)
    return {node: find(node) for node in part_of}


def _edges(cell: list[int]) -> list[Edge]:
    return [(min(pair), max(pair)) for pair in combinations(cell, 2)]


MILLIMETRE_M = 1e-3
# A sensing face leans at most 60 degrees from the base's plane, as cosine.
_SENSING_COSINE = 0.5


def make_gel(mesh: Tetrahedra, *, name: str) -> tuple[GelMesh, IndexArray]:
    """Return the gel of a mesh, with the middle of its thickness at z = 0, and its sensing triangles, shape [s, 3].

    The faces in the plane of the base are driven. Faces of the outer shell that lean at most 60 degrees from that plane
    and look away from it sense.

    Args:
        mesh: with its base at z = 0, in mm.
        name: how messages call it.

    Raises:
        MeshError: it cannot be simulated.
    """
    surface = mesh.surface
    if len(surface.triangles) == 0:
        raise MeshError(f"{name} has no outer surface: expected each tetrahedron once.")
    slope = surface.area_vectors_mm2[:, 2] / surface.areas_mm2
    outer = surface.shells == int(surface.shell_volumes_mm3().argmax())
    sensing = surface.triangles[(slope >= _SENSING_COSINE) & outer]
    middle = np.array([0.0, 0.0, 0.5 * float(mesh.nodes_mm[:, 2].max())])
    gel = GelMesh(
        rest_position_m=(mesh.nodes_mm - middle) * MILLIMETRE_M,
        tetrahedra=mesh.corners,
        driven=_mask(surface.triangles[mesh.base_faces], len(mesh.nodes_mm)),
        sensing=_mask(sensing, len(mesh.nodes_mm)),
        name=name,
    )
    return gel, sensing


def _mask(triangles: IndexArray, nodes: int) -> NDArray[np.bool_]:
    mask = np.zeros(nodes, dtype=np.bool_)
    mask[triangles.reshape(-1)] = True
    return mask
