"""The hashing and the proofs, on the published test tree of Certificate Transparency and on all sizes up to 70."""

from hashlib import sha256

import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.server.transparency.merkle import (
    EMPTY_ROOT,
    ProofRejected,
    Tree,
    check_consistency,
    check_inclusion,
    hash_leaf,
    make_tree,
)

LEAVES = [
    bytes.fromhex(each)
    for each in ("", "00", "10", "2021", "3031", "40414243", "5051525354555657", "606162636465666768696a6b6c6d6e6f")
]
ROOTS = [
    "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
    "fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",
    "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77",
    "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
    "4e3bbb1f7b478dcfe71fb631631519a3bca12c9aefca1612bfce4c13a86264d4",
    "76e67dadbcdf1e10e1b74ddc608abd2f98dfb16fbce75277b5232a127f2087ef",
    "ddb89be403809e325750d3d263cd78929c2942b7942a34b77e122c9594a74c8c",
    "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328",
]
"""Of RFC 6962's hash over the first leaves, from the tests of google/certificate-transparency."""


def a_tree(size: int) -> Tree:
    return make_tree([hash_leaf(b"%d" % number) for number in range(size)])


def test_the_roots_are_the_published_ones() -> None:
    assert make_tree([]).root() == EMPTY_ROOT == sha256().digest()
    tree = make_tree(list(map(hash_leaf, LEAVES)))
    assert [tree.root(size).hex() for size in range(1, 9)] == ROOTS


def test_the_proofs_are_the_published_ones() -> None:
    tree = make_tree(list(map(hash_leaf, LEAVES)))
    assert [each.hex() for each in tree.prove_inclusion(2, 3)] == [ROOTS[1]]
    assert [each.hex()[:8] for each in tree.prove_inclusion(5, 8)] == ["bc1a0643", "ca854ea1", "d37ee418"]
    assert [each.hex()[:8] for each in tree.prove_consistency(6, 8)] == ["0ebc5d34", "ca854ea1", "d37ee418"]
    assert [each.hex()[:8] for each in tree.prove_consistency(1, 1)] == []


@given(st.integers(1, 700), st.data())
def test_every_proof_shows_what_it_is_of_and_nothing_else(size: int, data: st.DataObject) -> None:
    tree = a_tree(size)
    index, old = data.draw(st.integers(0, size - 1)), data.draw(st.integers(1, size))
    proof = tree.prove_inclusion(index)
    check_inclusion(hash_leaf(b"%d" % index), index, size, proof, tree.root())
    consistency = tree.prove_consistency(old)
    check_consistency(old, size, consistency, tree.root(old), tree.root())
    with pytest.raises(ProofRejected):
        check_inclusion(hash_leaf(b"%d" % index), (index + 1) % (size + 1), size, proof, tree.root())
    with pytest.raises(ProofRejected):
        check_inclusion(hash_leaf(b"other"), index, size, proof, tree.root())
    other = make_tree([hash_leaf(b"%d" % (number + (number == old - 1))) for number in range(size)])
    with pytest.raises(ProofRejected):
        check_consistency(old, size, consistency, other.root(old), tree.root())
    with pytest.raises(ProofRejected):
        check_consistency(old, size, [*consistency, bytes(32)], tree.root(old), tree.root())


def test_a_tree_is_the_same_from_tiles_of_three_levels() -> None:
    """70,000 entries: 273 whole tiles and a partial one, one whole tile and one of 17 above, one of 1 at the top."""
    tree = a_tree(70_000)
    check_inclusion(hash_leaf(b"65535"), 65_535, 70_000, tree.prove_inclusion(65_535), tree.root())
    check_consistency(65_537, 70_000, tree.prove_consistency(65_537), a_tree(65_537).root(), tree.root())


def test_a_tile_of_another_width_is_refused() -> None:
    with pytest.raises(ProofRejected, match="Tile 0 of level 0: expected 5 hashes, got 4"):
        Tree(5, lambda *_: [bytes(32)] * 4).root()
    with pytest.raises(ProofRejected, match="Expected an index below the size"):
        a_tree(3).prove_inclusion(3)
    with pytest.raises(ProofRejected, match="Expected sizes up to 3 in order"):
        a_tree(3).prove_consistency(4)
