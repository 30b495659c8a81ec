"""Which rows meet when a mesh's nodes are eliminated, found once per mesh (static symbolic factorisation).

Nodes are eliminated in *fronts* (Duff & Reid 1983): small dense matrices of some pivot nodes and of all nodes that they
are coupled to by then. What is left of a front once its pivots are eliminated is added to that of its parent, the front
of the first node eliminated next. Places are numbers in the order of elimination.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .ordering import elimination_order

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

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
