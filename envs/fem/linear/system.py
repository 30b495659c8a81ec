"""Where the blocks of the Newton matrix stand, and in which fronts it is eliminated.

    [ K  B ]
    [ C  D ]

K couples the free nodes of the gels, in order of elimination, where their meshes or contacts do; the border holds the
frame points of the movable bodies, which may touch any of them. All entries stand in one flat array, in blocks of
3 x 3.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compilation import kernel
from ..algebra import Mat3
from .ordering import Elimination

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

NO_PLACE = -1
# Row stride of a block of two gel nodes.
GEL_STRIDE = 3


class BlockLayout(NamedTuple):
    """Places of the blocks of n / 3 gel nodes and m / 3 frame points.

    Block (a, a) of K at 9 a, and with GEL_STRIDE from row to row; so are those of different nodes, see `Neighbours`.
    B[i, j] at right + i m + j;  D[i, j] at corner + i m + j;  the columns of C that belong to node a, three numbers in
    each row, at bottom + 3 m a.
    """

    nodes: int  # of all gels, n / 3
    n: int
    m: int
    right: int
    bottom: int
    corner: int


class Neighbours(NamedTuple):
    """Gel nodes that are coupled: block (a, node[k]) of K at 3 n + 9 k for start[a] <= k < start[a + 1]."""

    start: IndexArray  # [n / 3 + 1]
    node: IndexArray  # [k] ascending for each a


class Fronts(NamedTuple):
    """Dense matrices in which nodes are eliminated, children before their parents; see `fronts`."""

    first: IndexArray  # [f + 1] first pivot; pivots are consecutive
    row_start: IndexArray  # [f + 1]
    rows: IndexArray  # [r] later nodes that a front reaches, ascending, frame points included
    slot: IndexArray  # [r] number of that node in the parent's front
    child_start: IndexArray  # [f + 1]
    children: IndexArray  # [f]
    passed: IndexArray  # [f] place on the stack of what a front passes on
    factor: IndexArray  # [f] place of its factors
    local: IndexArray  # [k] number of a neighbour in the front that eliminates the node; NO_PLACE if it is gone by then
    mirrored: IndexArray  # [k] the k of the opposite block
    widest: int  # rows of the largest front
    stack: int  # entries of the stack
    factors: int  # entries of all factors


class SystemLayout(NamedTuple):
    """Layout of a system and how it is eliminated."""

    block: BlockLayout
    neighbours: Neighbours
    size: int  # entries in all
    fronts: Fronts


def system_layout(eliminations: Sequence[Elimination], border: int) -> SystemLayout:
    """Return the layout for these eliminations of gels, one after the other, and this number of frame points."""
    starts = np.concatenate([[0], np.cumsum([len(part.nodes) for part in eliminations])])
    edges = np.concatenate([part.edges + start for part, start in zip(eliminations, starts[:-1], strict=True)])
    both_ways = np.concatenate([edges, edges[:, ::-1]])
    coupled = both_ways[np.lexsort((both_ways[:, 1], both_ways[:, 0]))]
    n, m = 3 * int(starts[-1]), 3 * border
    right = 3 * n + 9 * len(coupled)
    block = BlockLayout(
        nodes=int(starts[-1]),
        n=n,
        m=m,
        right=right,
        bottom=right + n * m,
        corner=right + 2 * n * m,
    )
    neighbours = Neighbours(
        start=np.searchsorted(coupled[:, 0], np.arange(starts[-1] + 1)), node=np.ascontiguousarray(coupled[:, 1])
    )
    first, rows = _joined_fronts(eliminations, starts, border)
    return SystemLayout(block, neighbours, block.corner + m * m, _fronts(first, rows, neighbours))


def _joined_fronts(
    eliminations: Sequence[Elimination], starts: IndexArray, border: int
) -> tuple[IndexArray, list[IndexArray]]:
    """Return first pivots and rows of the fronts of all gels, which all reach the border, and of the border."""
    total = int(starts[-1]) + border
    frame_points = np.arange(starts[-1], total)
    first, rows = [], []
    for part, start in zip(eliminations, starts[:-1], strict=True):
        first.append(part.first[:-1] + start)
        rows += [np.concatenate([reached + start, frame_points]) for reached in part.rows]
    if border:
        first.append(starts[-1:])
        rows.append(frame_points[:0])
    return np.concatenate([*first, [total]]), rows


def _fronts(first: IndexArray, rows: list[IndexArray], neighbours: Neighbours) -> Fronts:
    pivots, reached = np.diff(first), np.array([len(below) for below in rows])
    members = [np.concatenate([np.arange(*ends), below]) for *ends, below in zip(first, first[1:], rows, strict=False)]
    following = np.array([below[0] if len(below) else NO_PLACE for below in rows])
    parent = np.where(following == NO_PLACE, NO_PLACE, np.searchsorted(first, following, side="right") - 1)
    slots = [np.searchsorted(members[p], below) for p, below in zip(parent, rows, strict=True) if p != NO_PLACE]
    child_start = np.searchsorted(np.sort(parent), np.arange(len(rows) + 1))
    children = np.argsort(parent, kind="stable")
    passed, stack = _stack_places(child_start, children, (3 * reached) ** 2)
    local, mirrored = _neighbour_numbers(first, members, neighbours)
    sizes = 9 * pivots * (pivots + 2 * reached)
    widest = int((pivots + reached).max())
    return Fronts(
        first=first,
        row_start=np.concatenate([[0], np.cumsum(reached)]),
        rows=np.concatenate(rows),
        slot=np.concatenate([*slots, np.empty(0, dtype=np.int64)]),
        child_start=child_start,
        children=children,
        passed=passed,
        factor=np.cumsum(sizes) - sizes,
        local=local,
        mirrored=mirrored,
        widest=3 * widest,
        stack=stack,
        factors=int(sizes.sum()),
    )


def _stack_places(child_start: IndexArray, children: IndexArray, sizes: IndexArray) -> tuple[IndexArray, int]:
    """Return where each front's remainder stands until its parent takes it, and how high the stack grows."""
    places, top, highest = np.empty(len(sizes), dtype=np.int64), 0, 0
    for front, size in enumerate(sizes.tolist()):
        taken = children[child_start[front] : child_start[front + 1]]
        places[front] = top = min([top, *places[taken].tolist()])
        top += size
        highest = max(highest, top)
    return places, highest


def _neighbour_numbers(
    first: IndexArray, members: list[IndexArray], neighbours: Neighbours
) -> tuple[IndexArray, IndexArray]:
    """Return `local` and `mirrored` of `Fronts`."""
    start, other = neighbours
    count = len(start) - 1
    node = np.repeat(np.arange(count), np.diff(start))
    mirrored = np.searchsorted(node * count + other, other * count + node)
    local = np.full(len(node), NO_PLACE, dtype=np.int64)
    for front, nodes in enumerate(members):
        if first[front] < count:
            row = slice(start[first[front]], start[first[front + 1]])
            here = other[row]
            local[row] = np.where(here >= first[front], np.searchsorted(nodes, here), NO_PLACE)
    return local, mirrored


def gel_block_places(neighbours: Neighbours, rows: IndexArray, columns: IndexArray) -> IndexArray:
    """Return the places of blocks of coupled gel nodes; NO_PLACE where a number is negative (no unknown)."""
    count = len(neighbours.start) - 1
    node = np.repeat(np.arange(count), np.diff(neighbours.start))
    numbers = np.searchsorted(node * count + neighbours.node, rows * count + columns)
    places = 9 * np.where(rows == columns, rows, count + numbers)
    return np.where((rows < 0) | (columns < 0), NO_PLACE, places)


@kernel
def block_place(layout: BlockLayout, a: int, b: int) -> tuple[int, int]:
    """Return place and row stride of the block of unknowns a and b, which are the same or one of them a frame point.

    The blocks of one row and of the frame points of one body adjoin.
    """
    n, m = layout.nodes, layout.m
    if b < n:
        return (layout.bottom + 3 * m * b + 9 * (a - n) if a >= n else 9 * a), GEL_STRIDE
    if a < n:
        return layout.right + 3 * (m * a + b - n), m
    return layout.corner + 3 * (m * (a - n) + b - n), m


@kernel
def gel_block_place(start: IndexArray, node: IndexArray, a: int, b: int) -> int:
    """Return the place of the block of two gel nodes, from `Neighbours`; NO_PLACE if they are not coupled."""
    if a == b:
        return 9 * a
    low, high = start[a], start[a + 1]
    while low < high:
        middle = (low + high) // 2
        if node[middle] < b:
            low = middle + 1
        else:
            high = middle
    return 9 * (len(start) - 1 + low) if low < start[a + 1] and node[low] == b else NO_PLACE


@kernel
def add_block(entries: FloatArray, place: int, stride: int, block: Mat3) -> None:
    """Add a 3 x 3 block, given by its rows."""
    entries[place] += block[0][0]
    entries[place + 1] += block[0][1]
    entries[place + 2] += block[0][2]
    entries[place + stride] += block[1][0]
    entries[place + stride + 1] += block[1][1]
    entries[place + stride + 2] += block[1][2]
    entries[place + 2 * stride] += block[2][0]
    entries[place + 2 * stride + 1] += block[2][1]
    entries[place + 2 * stride + 2] += block[2][2]
