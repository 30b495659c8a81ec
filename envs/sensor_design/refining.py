"""Refines a tetrahedral mesh without changing its shape: everywhere, or where a flat body would touch it first.

All tetrahedra at an edge are halved with it, so that they still meet at whole faces (M.-C. Rivara, Mesh refinement
processes based on the generalized bisection of simplices, SIAM J. Numer. Anal. 21 (1984) 604-613). Edges of one length
are taken in the order of their middles, so the numbers of the nodes do not matter.
"""

from collections import Counter, defaultdict
from heapq import heapify, heappop, heappush
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from .tetrahedra import Tetrahedra

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
