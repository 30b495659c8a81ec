"""Cuts of closed surfaces by a plane: the outlines that a section shows. Used for cut-open parts and section views."""

import numpy as np
from numpy.typing import NDArray

from ...scene.perspective import Plane

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


def section_loops_m(vertices_m: FloatArray, triangles: IndexArray, plane: Plane) -> list[FloatArray]:
    """Return the closed outlines where a plane cuts a closed surface, each [k, 3] [m], the first point not repeated.

    Seen against the plane's normal, material lies to the left of an outline, so that outlines of holes turn the other
    way. A vertex exactly on the plane counts as above it.
    """
    following = dict(_crossings(triangles, plane.heights_m(vertices_m) >= 0.0))
    heights = plane.heights_m(vertices_m)
    loops = []
    while following:
        edge, after = following.popitem()
        loop = [_crossing_point(vertices_m, heights, edge)]
        while after != edge:
            loop.append(_crossing_point(vertices_m, heights, after))
            after = following.pop(after)
        loops.append(np.array(loop))
    return loops


Edge = tuple[int, int]


def _crossings(triangles: IndexArray, above: NDArray[np.bool_]) -> list[tuple[Edge, Edge]]:
    """Return the edges by which the outline enters and leaves each triangle that the plane cuts."""
    cut = above[triangles].any(axis=1) & ~above[triangles].all(axis=1)
    return [_entry_and_exit(triangle, above) for triangle in triangles[cut].tolist()]


def _entry_and_exit(triangle: list[int], above: NDArray[np.bool_]) -> tuple[Edge, Edge]:
    """Return the two crossings of an outline: in by the edge that falls through the plane, out by the rising one."""
    edges = [(triangle[i], triangle[(i + 1) % 3]) for i in range(3)]
    falling = next(edge for edge in edges if above[edge[0]] and not above[edge[1]])
    rising = next(edge for edge in edges if not above[edge[0]] and above[edge[1]])
    return _undirected(falling), _undirected(rising)


def _undirected(edge: Edge) -> Edge:
    return (edge[0], edge[1]) if edge[0] < edge[1] else (edge[1], edge[0])


def _crossing_point(vertices_m: FloatArray, heights: FloatArray, edge: Edge) -> FloatArray:
    a, b = edge
    part = heights[a] / (heights[a] - heights[b])
    return np.asarray(vertices_m[a] + part * (vertices_m[b] - vertices_m[a]))
