"""The order in which unknowns are eliminated, and the fronts that follow from it."""

from heapq import heapify, heappop, heappush
from typing import NamedTuple

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


# Nodes of the border that are reckoned with in every front: the frame points of one body.
_BORDER = 4
# Time of handling a front, of clearing and storing one of its entries, and of passing one on, in floating point
# operations of the elimination; estimates, which need only be right to a factor of two or so.
_FRONT_COST, _ENTRY_COST, _PASSED_ENTRY_COST = 3000, 4, 12


class Elimination(NamedTuple):
    """How the free nodes of one mesh are eliminated."""

    nodes: IndexArray  # [n] mesh node at every place
    edges: IndexArray  # [e, 2] coupled places, each pair once
    first: IndexArray  # [f + 1] first pivot of each front, in order; each front's pivots are consecutive places
    rows: tuple[IndexArray, ...]  # [f] places after its pivots that a front reaches, ascending


def plan_elimination(free: IndexArray, edges: IndexArray, positions_m: FloatArray) -> Elimination:
    """Plan the elimination of the mesh nodes `free` [n] at `positions_m` [n, 3], coupled by `edges` [e, 2]."""
    order = elimination_order(edges, positions_m)
    pivots, below = _fronts(_places(order)[edges], len(order))
    final = np.concatenate([np.array(group, dtype=np.int64) for group in pivots])
    moved = _places(final)
    rows = tuple(np.sort(moved[np.array(sorted(reached), dtype=np.int64)]) for reached in below)
    nodes = order[final]
    sizes = [len(group) for group in pivots]
    return Elimination(free[nodes], _places(nodes)[edges], np.concatenate([[0], np.cumsum(sizes)]), rows)


def _places(order: IndexArray) -> IndexArray:
    places = np.empty(len(order), dtype=np.int64)
    places[order] = np.arange(len(order))
    return places


def _fronts(edges: IndexArray, count: int) -> tuple[list[list[int]], list[set[int]]]:
    """Return the pivots of each front and the nodes it reaches, children before their parents.

    Nodes are numbered in order of elimination. A child joins its parent's front where that is predicted to be faster.
    """
    below = _reached(edges, count)
    pivots = [[node] for node in range(count)]
    children: list[list[int]] = [[] for _ in range(count)]
    roots = []
    for node in range(count):
        kept = []
        for child in reversed(children[node]):
            apart = _cost(len(pivots[child]), len(below[child])) + _cost(len(pivots[node]), len(below[node]))
            if _cost(len(pivots[child]) + len(pivots[node]), len(below[node])) <= apart:
                pivots[node] = pivots[child] + pivots[node]
                kept += children[child]
            else:
                kept.append(child)
        children[node] = sorted(kept)
        if below[node]:
            children[min(below[node])].append(node)
        else:
            roots.append(node)
    order = _children_first(roots, children)
    return [pivots[node] for node in order], [below[node] for node in order]


def _reached(edges: IndexArray, count: int) -> list[set[int]]:
    """Return the later nodes that each node is coupled to when it is eliminated, fill included."""
    below: list[set[int]] = [set() for _ in range(count)]
    for a, b in edges.tolist():
        below[min(a, b)].add(max(a, b))
    for reached in below:
        if reached:
            following = min(reached)
            below[following] |= reached
            below[following].discard(following)
    return below


def _children_first(roots: list[int], children: list[list[int]]) -> list[int]:
    order = []
    waiting = list(roots)
    while waiting:
        node = waiting.pop()
        order.append(node)
        waiting += children[node]
    return order[::-1]


def _cost(pivots: int, reached: int) -> int:
    """Return the predicted time of a front, in floating point operations."""
    size, left = pivots + reached + _BORDER, reached + _BORDER
    # Pivot node i of a front updates (size - i)^2 blocks with 54 operations each.
    elimination = 9 * (size * (size - 1) * (2 * size - 1) - left * (left - 1) * (2 * left - 1))
    return _FRONT_COST + elimination + 9 * (_ENTRY_COST * size * size + _PASSED_ENTRY_COST * left * left)
