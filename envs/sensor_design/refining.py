"""Refines a tetrahedral mesh without changing its shape, so that what depends on the mesh alone can be told apart."""

from collections import defaultdict
from heapq import heapify, heappop, heappush
from itertools import combinations

import numpy as np

from .tetrahedra import Tetrahedra

Edge = tuple[int, int]
Point = tuple[float, float, float]


def refined(mesh: Tetrahedra, nodes: int) -> Tetrahedra:
    """Return a mesh of the same body with at least so many nodes: its longest edges are halved, one after the other.

    All tetrahedra at an edge are halved with it, so that they go on to meet at whole faces (M.-C. Rivara, Mesh
    refinement processes based on the generalized bisection of simplices, SIAM J. Numer. Anal. 21 (1984) 604-613).
    Edges of one length are taken in the order of their middles, so the numbers of the nodes do not matter.
    """
    points: list[Point] = [(x, y, z) for x, y, z in mesh.nodes_mm.tolist()]
    cells: list[list[int]] = mesh.corners.tolist()
    around: dict[Edge, set[int]] = defaultdict(set)
    for number, cell in enumerate(cells):
        for edge in _edges(cell):
            around[edge].add(number)
    waiting = [_entry(points, edge) for edge in around]
    heapify(waiting)
    while len(points) < nodes:
        _, middle, edge = heappop(waiting)
        points.append(middle)
        new: set[Edge] = set()
        for number in sorted(around.pop(edge)):
            new |= _halved(cells, number, edge, len(points) - 1, around)
        for added in sorted(new):
            heappush(waiting, _entry(points, added))
    return Tetrahedra(nodes_mm=np.array(points), corners=np.array(cells, dtype=np.int64))


def _halved(cells: list[list[int]], number: int, edge: Edge, middle: int, around: dict[Edge, set[int]]) -> set[Edge]:
    """Put a tetrahedron's halves in its place and at the end; return the edges that have come with them."""
    whole = cells[number]
    first, second = ([middle if node == end else node for node in whole] for end in edge)
    cells[number] = first
    cells.append(second)
    for old in _edges(whole):
        if old != edge:
            around[old].discard(number)
    for index, half in ((number, first), (len(cells) - 1, second)):
        for own in _edges(half):
            around[own].add(index)
    return {own for half in (first, second) for own in _edges(half) if middle in own}


def _edges(cell: list[int]) -> list[Edge]:
    return [(min(pair), max(pair)) for pair in combinations(cell, 2)]


def _entry(points: list[Point], edge: Edge) -> tuple[float, Point, Edge]:
    """Return an edge as it waits: longest first, then by its middle."""
    (ax, ay, az), (bx, by, bz) = points[edge[0]], points[edge[1]]
    squared = (ax - bx) * (ax - bx) + (ay - by) * (ay - by) + (az - bz) * (az - bz)
    return -squared, (0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz)), edge
