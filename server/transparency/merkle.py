"""Merkle trees of RFC 6962, section 2.1: roots, inclusion and consistency proofs, and their checks.

A `Tree` computes them from tiles (https://c2sp.org/tlog-tiles): 256 neighbouring hashes of one level in each.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from hashlib import sha256
from typing import Final

from vitac.errors import VitacError

TILE_HEIGHT: Final = 8
TILE_WIDTH: Final = 1 << TILE_HEIGHT
EMPTY_ROOT: Final = sha256(b"").digest()

ReadTile = Callable[[int, int, int], Sequence[bytes]]
"""Returns the hashes of a tile, of its level, its number in the level and its width."""


class ProofRejected(VitacError):
    """A proof does not show what it is said to show, or a tile is not that of the tree."""


def hash_leaf(entry: bytes) -> bytes:
    """Return the hash of an entry."""
    return sha256(b"\0" + entry).digest()


def hash_children(left: bytes, right: bytes) -> bytes:
    """Return the hash of a node with two children."""
    return sha256(b"\1" + left + right).digest()


def hash_complete(hashes: Sequence[bytes]) -> bytes:
    """Return the root over 1, 2, 4, 8 ... neighbouring hashes."""
    while len(hashes) > 1:
        hashes = [hash_children(*hashes[at : at + 2]) for at in range(0, len(hashes), 2)]
    return hashes[0]


class Tree:
    """A tree of some size, whose hashes are in tiles.

    Raises:
        ProofRejected: here and in all methods, a tile has another number of hashes than it must have.
    """

    def __init__(self, size: int, read_tile: ReadTile) -> None:
        self.size = size
        self.read_tile = cache(read_tile)

    def root(self, size: int | None = None) -> bytes:
        """Return the root over the first entries; `size` None: over all."""
        size = self.size if size is None else size
        return self._hash_range(0, size) if size else EMPTY_ROOT

    def prove_inclusion(self, index: int, size: int | None = None) -> list[bytes]:
        """Return the proof that the entry of an index, from 0, is in the tree of a size; None: in the whole."""
        size = self.size if size is None else size
        if not 0 <= index < size <= self.size:
            raise ProofRejected(f"Expected an index below the size, got {index} and {size} in a tree of {self.size}.")
        return list(self._path(index, 0, size))

    def prove_consistency(self, old: int, new: int | None = None) -> list[bytes]:
        """Return the proof that the tree of the size `old` is the beginning of that of `new`; None: of the whole."""
        new = self.size if new is None else new
        if not 0 <= old <= new <= self.size:
            raise ProofRejected(f"Expected sizes up to {self.size} in order, got {old} and {new}.")
        return list(self._subproof(old, 0, new, is_known=True)) if 0 < old < new else []

    def _path(self, index: int, start: int, end: int) -> Iterator[bytes]:
        if end - start > 1:
            middle = start + _split(end - start)
            if index < middle:
                yield from self._path(index, start, middle)
                yield self._hash_range(middle, end)
            else:
                yield from self._path(index, middle, end)
                yield self._hash_range(start, middle)

    def _subproof(self, old: int, start: int, end: int, *, is_known: bool) -> Iterator[bytes]:
        if old == end:
            if not is_known:
                yield self._hash_range(start, end)
            return
        middle = start + _split(end - start)
        if old <= middle:
            yield from self._subproof(old, start, middle, is_known=is_known)
            yield self._hash_range(middle, end)
        else:
            yield from self._subproof(old, middle, end, is_known=False)
            yield self._hash_range(start, middle)

    def _hash_range(self, start: int, end: int) -> bytes:
        """Return the root over the entries of a subtree, which begins where a tree of its size may begin."""
        n_entries = end - start
        if n_entries & (n_entries - 1) == 0:
            return self._hash_subtree(n_entries.bit_length() - 1, start)
        middle = start + _split(n_entries)
        return hash_children(self._hash_range(start, middle), self._hash_range(middle, end))

    def _hash_subtree(self, height: int, start: int) -> bytes:
        level, height_in_tile = divmod(height, TILE_HEIGHT)
        number, offset = divmod(start >> (TILE_HEIGHT * level), TILE_WIDTH)
        width = min(TILE_WIDTH, (self.size >> (TILE_HEIGHT * level)) - TILE_WIDTH * number)
        hashes = self.read_tile(level, number, width)
        if len(hashes) != width:
            raise ProofRejected(f"Tile {number} of level {level}: expected {width} hashes, got {len(hashes)}.")
        return hash_complete(hashes[offset : offset + (1 << height_in_tile)])


def make_tree(leaves: Sequence[bytes]) -> Tree:
    """Return the tree of leaf hashes that are all at hand."""
    levels = [leaves]
    while len(levels[-1]) >= TILE_WIDTH:
        below = levels[-1]
        ends = range(TILE_WIDTH, len(below) + 1, TILE_WIDTH)
        levels.append([hash_complete(below[end - TILE_WIDTH : end]) for end in ends])

    def read_tile(level: int, number: int, width: int) -> Sequence[bytes]:
        return levels[level][TILE_WIDTH * number : TILE_WIDTH * number + width]

    return Tree(len(leaves), read_tile)


def check_inclusion(leaf: bytes, index: int, size: int, proof: Sequence[bytes], root: bytes) -> None:
    """Refuse a proof that does not show a leaf at an index of the tree with a root (RFC 9162, 2.1.3.2).

    Raises:
        ProofRejected: it shows something else.
    """
    if not 0 <= index < size:
        raise ProofRejected(f"Expected an index below the size {size}, got {index}.")
    at, last, computed = index, size - 1, leaf
    for node in proof:
        if last == 0:
            raise ProofRejected(f"The inclusion proof of index {index} is too long.")
        if at & 1 or at == last:
            computed = hash_children(node, computed)
            while not at & 1 and at:
                at, last = at >> 1, last >> 1
        else:
            computed = hash_children(computed, node)
        at, last = at >> 1, last >> 1
    if last or computed != root:
        raise ProofRejected(f"The inclusion proof does not lead from entry {index} to the root of {size} entries.")


def check_consistency(old: int, new: int, proof: Sequence[bytes], old_root: bytes, new_root: bytes) -> None:
    """Refuse a proof that does not show one tree as the beginning of another (RFC 9162, 2.1.4.2).

    Raises:
        ProofRejected: they are not consistent by it.
    """
    wrong = ProofRejected(f"The log of {new} entries is no continuation of the log of {old} entries.")
    if old > new:
        raise wrong
    if old in {0, new}:
        if proof or (old == new and old_root != new_root) or (old == 0 and old_root != EMPTY_ROOT):
            raise wrong
        return
    nodes = [old_root, *proof] if old & (old - 1) == 0 else list(proof)
    if not nodes:
        raise wrong
    at, last = old - 1, new - 1
    while at & 1:
        at, last = at >> 1, last >> 1
    found_old = found_new = nodes[0]
    for node in nodes[1:]:
        if last == 0:
            raise wrong
        if at & 1 or at == last:
            found_old, found_new = hash_children(node, found_old), hash_children(node, found_new)
            while not at & 1 and at:
                at, last = at >> 1, last >> 1
        else:
            found_new = hash_children(found_new, node)
        at, last = at >> 1, last >> 1
    if last or found_old != old_root or found_new != new_root:
        raise wrong


def _split(n_entries: int) -> int:
    """Return the largest power of two below a number."""
    return 1 << ((n_entries - 1).bit_length() - 1)
