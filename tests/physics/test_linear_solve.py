"""The band and border solver against dense linear algebra, and the node order that makes the band narrow."""

import numpy as np
import pytest
from block_meshes import box_gel
from engine_probe import dense_matrix, right_hand_side
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from vectors import vec3
from vitac.envs.fem.linear_solve import SystemLayout, add_block, block_place, solve, system_layout
from vitac.envs.fem.ordering import bandwidth, elimination_reach, reverse_cuthill_mckee

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


def random_graph(random: np.random.Generator, nodes: int, reach: int) -> IndexArray:
    pairs = [(i, j) for i in range(nodes) for j in range(i + 1, min(nodes, i + reach + 1)) if random.random() < 0.6]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def random_system(
    seed: int, nodes: int, reach: int, border_nodes: int, *, symmetric: bool = False, shift: float = 30.0
) -> tuple[SystemLayout, FloatArray, FloatArray, FloatArray]:
    """Layout, entries, and the same matrix and right-hand side as dense arrays."""
    random = np.random.default_rng(seed)
    edges = random_graph(random, nodes, reach)
    position = np.arange(nodes)
    layout = system_layout(elimination_reach(edges, position), bandwidth(edges, position), 3 * border_nodes)
    total = nodes + border_nodes
    entries = np.zeros(layout.size)
    matrix = np.zeros((3 * total, 3 * total))
    coupled = [(int(a), int(b)) for a, b in edges] + [(i, i) for i in range(total)]
    coupled += [(i, j) for i in range(total) for j in range(max(i + 1, nodes), total)]
    for a, b in coupled:
        block = random.normal(size=(3, 3)) + (shift * np.eye(3) if a == b else 0)
        if symmetric and a == b:
            block = block + block.T
        pairs = (
            [(a, b, block)] if a == b else [(a, b, block), (b, a, block.T if symmetric else random.normal(size=(3, 3)))]
        )
        for i, j, values in pairs:
            place, stride = block_place(layout.block, i, j)
            add_block(entries, place, stride, (vec3(values[0]), vec3(values[1]), vec3(values[2])))
            matrix[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] += values
    rhs = random.normal(size=3 * total)
    n, m = layout.block.n, layout.block.m
    for i in range(3 * total):
        place = layout.block.right + i * (m + 1) + m if i < n else layout.block.corner + (i - n) * (m + 1) + m
        entries[place] = rhs[i]
    return layout, entries, matrix, rhs


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    nodes=st.integers(1, 25),
    reach=st.integers(0, 6),
    border_nodes=st.integers(0, 8),
    symmetric=st.booleans(),
)
def test_solution_is_that_of_dense_linear_algebra(
    seed: int, nodes: int, reach: int, border_nodes: int, symmetric: bool
) -> None:
    layout, entries, matrix, rhs = random_system(seed, nodes, reach, border_nodes, symmetric=symmetric)
    np.testing.assert_array_equal(dense_matrix(layout, entries), matrix)
    np.testing.assert_array_equal(right_hand_side(layout, entries), rhs)
    solution = np.empty(len(rhs))
    assert solve(layout, entries, solution, False)
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, rhs), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_positive_flag_tells_definite_from_indefinite_matrices(seed: int) -> None:
    for shift in (30.0, 1.0, -30.0):
        layout, entries, matrix, _ = random_system(seed, 8, 2, 2, symmetric=True, shift=shift)
        definite = bool(np.linalg.eigvalsh(matrix).min() > 0)
        assert solve(layout, entries, np.empty(len(matrix)), True) is definite


def test_a_negative_pivot_is_no_obstacle_without_the_flag() -> None:
    layout, entries, matrix, rhs = random_system(3, 6, 2, 2, shift=-30.0)
    solution = np.empty(len(rhs))
    assert solve(layout, entries, solution, False)
    np.testing.assert_allclose(matrix @ solution, rhs, atol=1e-9)


@pytest.mark.parametrize("where", ["band", "border"])
def test_a_singular_matrix_is_reported(where: str) -> None:
    layout, entries, matrix, _ = random_system(0, 4, 1, 2)
    node = 3 if where == "band" else 5
    for other in range(6):
        for i, j in ((node, other), (other, node)):
            if matrix[3 * i, 3 * j] != 0:
                place, stride = block_place(layout.block, i, j)
                for k in range(3):
                    entries[place + k * stride : place + k * stride + 3] = 0
    assert not solve(layout, entries, np.empty(len(matrix)), False)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), nodes=st.integers(1, 40))
def test_order_is_a_permutation_that_does_not_depend_on_the_order_of_edges(seed: int, nodes: int) -> None:
    random = np.random.default_rng(seed)
    edges = random_graph(random, nodes, 5)
    order = reverse_cuthill_mckee(edges, nodes)
    assert sorted(order.tolist()) == list(range(nodes))
    shuffled = random.permutation(edges) if len(edges) else edges
    np.testing.assert_array_equal(reverse_cuthill_mckee(shuffled, nodes), order)


def test_order_recovers_the_narrow_band_of_a_shuffled_chain() -> None:
    random = np.random.default_rng(0)
    names = random.permutation(60)
    edges = np.stack([names[:-1], names[1:]], axis=1).astype(np.int64)
    order = reverse_cuthill_mckee(edges, 60)
    position = np.empty(60, dtype=np.int64)
    position[order] = np.arange(60)
    assert bandwidth(edges, position) == 1


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), nodes=st.integers(2, 15))
def test_elimination_never_reaches_further_than_it_says(seed: int, nodes: int) -> None:
    random = np.random.default_rng(seed)
    edges = random_graph(random, nodes, 6)
    reach = elimination_reach(edges, np.arange(nodes))
    matrix = np.eye(nodes) * 20
    for a, b in edges:
        matrix[a, b], matrix[b, a] = random.normal(size=2)
    for k in range(nodes):
        below = np.flatnonzero(np.abs(matrix[k + 1 :, k]) > 1e-14) + k + 1
        right = np.flatnonzero(np.abs(matrix[k, k + 1 :]) > 1e-14) + k + 1
        assert max([k, *below.tolist(), *right.tolist()]) <= reach[k]
        matrix[k + 1 :, k:] -= np.outer(matrix[k + 1 :, k] / matrix[k, k], matrix[k, k:])


def test_a_block_has_a_band_about_as_wide_as_its_cross_section() -> None:
    mesh = box_gel((0.02, 0.006, 0.004), (10, 3, 2))
    assert mesh.elimination.bandwidth <= 2 * 4 * 2 + 4
    assert sorted(mesh.elimination.nodes.tolist()) == np.flatnonzero(~mesh.driven).tolist()
