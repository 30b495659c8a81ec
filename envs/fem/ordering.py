"""Node ordering with a small bandwidth."""

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

IndexArray = NDArray[np.int64]


class Elimination(NamedTuple):
    """In which order to eliminate nodes, and how far their rows then reach."""

    nodes: IndexArray  # [n] in order
    bandwidth: int  # largest distance in the order between two coupled nodes
    last: IndexArray  # [n] last place that eliminating a place couples to


def reverse_cuthill_mckee(edges: IndexArray, count: int) -> IndexArray:
    """Order of the nodes 0 .. count - 1 of a graph with undirected `edges` [e, 2]; George & Liu (1981), section 4.3.

    Each component starts at a pseudo-peripheral node; ties go to the smaller node number, so the order is unique.
    """
    neighbours: list[list[int]] = [[] for _ in range(count)]
    for a, b in edges.tolist():
        neighbours[a].append(b)
        neighbours[b].append(a)
    degree = [len(n) for n in neighbours]
    for adjacent in neighbours:
        adjacent.sort(key=lambda node: (degree[node], node))
    order: list[int] = []
    seen = [False] * count
    for start in sorted(range(count), key=lambda node: (degree[node], node)):
        if not seen[start]:
            component = _breadth_first(_peripheral_node(start, neighbours, degree), neighbours)
            for node in component[0]:
                seen[node] = True
            order.extend(component[0])
    return np.array(order[::-1], dtype=np.int64)


def bandwidth(edges: IndexArray, position: IndexArray) -> int:
    """Largest distance in the order between two adjacent nodes; position[node] is a node's place."""
    if len(edges) == 0:
        return 0
    return int(np.abs(position[edges[:, 0]] - position[edges[:, 1]]).max())


def elimination_reach(edges: IndexArray, position: IndexArray) -> IndexArray:
    """Last place that eliminating each place couples to, fill included, shape [n]: a running maximum."""
    last = np.arange(len(position))
    first, second = position[edges[:, 0]], position[edges[:, 1]]
    np.maximum.at(last, np.minimum(first, second), np.maximum(first, second))
    return np.maximum.accumulate(last)


def _breadth_first(start: int, neighbours: list[list[int]]) -> tuple[list[int], int, list[int]]:
    """Nodes in breadth-first order, the number of levels, and the nodes of the last level."""
    level = {start: 0}
    queue = deque([start])
    order = []
    while queue:
        node = queue.popleft()
        order.append(node)
        for other in neighbours[node]:
            if other not in level:
                level[other] = level[node] + 1
                queue.append(other)
    depth = level[order[-1]]
    return order, depth, [node for node in order if level[node] == depth]


def _peripheral_node(start: int, neighbours: list[list[int]], degree: list[int]) -> int:
    """A node of nearly greatest eccentricity, by repeated breadth-first search from the last level."""
    _, depth, last = _breadth_first(start, neighbours)
    while True:
        candidate = min(last, key=lambda node: (degree[node], node))
        _, new_depth, last = _breadth_first(candidate, neighbours)
        if new_depth <= depth:
            return candidate
        depth = new_depth
