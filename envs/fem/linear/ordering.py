"""In which order to eliminate the nodes of a mesh, so that little fills in: nested dissection, then minimum degree."""

from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
MaskArray = NDArray[np.bool_]

# Parts of at most this number of nodes are ordered by minimum degree, which is better there.
_SMALL_PART = 100
# Places of the planes that are tried, as parts of the nodes on one side.
_CUTS = (0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7)


def elimination_order(edges: IndexArray, positions_m: FloatArray) -> IndexArray:
    """Order of the nodes of a mesh graph with undirected `edges` [e, 2] and node positions [m], shape [n, 3].

    Nested dissection (George 1973): planes across the coordinate axes cut the mesh into two parts and a separator that
    is eliminated after them, again and again. It depends on nothing but the arguments, and not on the order of edges.
    """
    neighbours: list[set[int]] = [set() for _ in positions_m]
    for a, b in edges.tolist():
        neighbours[a].add(b)
        neighbours[b].add(a)
    order: list[int] = []
    _dissect(np.arange(len(positions_m)), edges, positions_m, neighbours, order)
    return np.array(order, dtype=np.int64)


def minimum_degree(nodes: list[int], neighbours: list[set[int]]) -> list[int]:
    """Order of some nodes that takes next the one coupled to fewest others then; ties go to the smaller number.

    The others of their neighbours count, but are eliminated later.
    """
    coupled = {node: set(neighbours[node]) for node in nodes}
    queue = [(len(others), node) for node, others in coupled.items()]
    heapify(queue)
    order = []
    while queue:
        degree, node = heappop(queue)
        if node not in coupled or degree != len(coupled[node]):
            continue
        order.append(node)
        others = coupled.pop(node)
        for other in sorted(others):
            if other in coupled:
                coupled[other] |= others
                coupled[other] -= {node, other}
                heappush(queue, (len(coupled[other]), other))
    return order


def _dissect(
    nodes: IndexArray, edges: IndexArray, positions_m: FloatArray, neighbours: list[set[int]], order: list[int]
) -> None:
    """Append an order of `nodes`, among which are `edges`."""
    separated = None if len(nodes) <= _SMALL_PART else _best_separator(nodes, edges, positions_m)
    if separated is None:
        order += minimum_degree(nodes.tolist(), neighbours)
        return
    lower, separator = separated
    inside = np.zeros(len(positions_m), dtype=np.bool_)
    for part in (nodes[lower[nodes] & ~separator[nodes]], nodes[~lower[nodes] & ~separator[nodes]]):
        inside[:] = False
        inside[part] = True
        _dissect(part, edges[inside[edges].all(axis=1)], positions_m, neighbours, order)
    order += nodes[separator[nodes]].tolist()


def _best_separator(
    nodes: IndexArray, edges: IndexArray, positions_m: FloatArray
) -> tuple[MaskArray, MaskArray] | None:
    """Return masks of the nodes below a plane and of its separator: few nodes between parts of about equal size."""
    best = None
    smallest = len(nodes) ** 2
    for axis in range(3):
        along = positions_m[:, axis]
        ordered = np.sort(along[nodes])
        for cut in np.unique(ordered[[int(part * (len(nodes) - 1)) for part in _CUTS]]):
            lower = along <= cut
            crossing = edges[lower[edges[:, 0]] != lower[edges[:, 1]]].ravel()
            below = int(lower[nodes].sum())
            for side in (True, False):
                separator = np.unique(crossing[lower[crossing] == side])
                parts = (below - side * len(separator), len(nodes) - below - (not side) * len(separator))
                score = len(separator) * max(parts)
                if min(parts) > 0 and score < smallest:
                    smallest, best = score, (lower, separator)
    if best is None:
        return None
    mask = np.zeros(len(positions_m), dtype=np.bool_)
    mask[best[1]] = True
    return best[0], mask
