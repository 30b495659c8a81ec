"""The multifrontal solver against dense linear algebra, and the order of elimination that keeps its fronts small."""

import numpy as np
import pytest
from block_meshes import box_gel
from engine_probe import dense_matrix, system_place
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from vectors import vec3
from vitac.envs.fem.linear.elimination import (
    Factor,
    factorise,
    has_negative_determinant,
    negative_curvature_direction,
    new_factor,
    substitute,
)
from vitac.envs.fem.linear.ordering import Elimination, elimination_order, minimum_degree, plan_elimination
from vitac.envs.fem.linear.system import NO_PLACE, SystemLayout, add_block, gel_block_places, system_layout

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]


def random_graph(random: np.random.Generator, nodes: int, part: float = 0.3) -> IndexArray:
    pairs = [(i, j) for i in range(nodes) for j in range(i + 1, nodes) if random.random() < part]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def random_elimination(random: np.random.Generator, nodes: int) -> Elimination:
    """Elimination of a sparse random graph with random node positions."""
    return plan_elimination(
        np.arange(nodes), random_graph(random, nodes, min(1.0, 3 / nodes)), random.random((nodes, 3))
    )


def random_system(
    seed: int, sizes: tuple[int, ...], border: int, *, symmetric: bool = False, shift: float = 60.0
) -> tuple[SystemLayout, FloatArray]:
    """Layout of gels of these sizes and a border, and entries at every place of its pattern."""
    random = np.random.default_rng(seed)
    layout = system_layout([random_elimination(random, size) for size in sizes], border)
    entries = np.zeros(layout.size)
    total = sum(sizes) + border
    for a in range(total):
        for b in range(a, total):
            if system_place(layout, a, b)[0] == NO_PLACE:
                continue
            block = random.normal(size=(3, 3)) + (shift * np.eye(3) if a == b else 0)
            opposite = block.T if symmetric else random.normal(size=(3, 3))
            if a == b:
                fill(layout, entries, a, a, block + block.T if symmetric else block)
            else:
                fill(layout, entries, a, b, block)
                fill(layout, entries, b, a, opposite)
    return layout, entries


def fill(layout: SystemLayout, entries: FloatArray, a: int, b: int, block: FloatArray) -> None:
    place, stride = system_place(layout, a, b)
    add_block(entries, place, stride, (vec3(block[0]), vec3(block[1]), vec3(block[2])))


def factors(layout: SystemLayout, entries: FloatArray) -> Factor:
    factor = new_factor(layout)
    assert factorise(layout, entries, factor, False)
    return factor


def solution(layout: SystemLayout, entries: FloatArray, rhs: FloatArray) -> FloatArray:
    x = rhs.copy()
    substitute(layout, factors(layout, entries), x)
    return x


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    sizes=st.lists(st.integers(1, 30), min_size=1, max_size=3),
    border=st.integers(0, 8),
    symmetric=st.booleans(),
)
def test_solution_is_that_of_dense_linear_algebra(seed: int, sizes: list[int], border: int, symmetric: bool) -> None:
    layout, entries = random_system(seed, tuple(sizes), border, symmetric=symmetric)
    matrix = dense_matrix(layout, entries)
    rhs = np.random.default_rng(seed).normal(size=len(matrix))
    before = entries.copy()
    np.testing.assert_allclose(solution(layout, entries, rhs), np.linalg.solve(matrix, rhs), rtol=1e-8, atol=1e-11)
    np.testing.assert_array_equal(entries, before)


def test_every_entry_of_the_pattern_has_a_place_of_its_own() -> None:
    layout, _ = random_system(5, (12, 7), 4)
    matrix = dense_matrix(layout, np.arange(1.0, layout.size + 1))
    np.testing.assert_array_equal(np.sort(matrix[matrix > 0]), np.arange(1.0, layout.size + 1))
    assert system_place(layout, 3, 15)[0] == NO_PLACE, "two gels are not coupled"


def test_places_of_a_table_of_nodes_are_those_of_single_pairs() -> None:
    layout, _ = random_system(6, (15,), 2)
    pairs = [(a, b) for a in range(15) for b in range(15) if system_place(layout, a, b)[0] != NO_PLACE]
    rows, columns = np.array([*pairs, (-1, 3), (3, -1)]).T
    expected = [system_place(layout, a, b)[0] for a, b in pairs] + [NO_PLACE, NO_PLACE]
    assert gel_block_places(layout.neighbours, rows, columns).tolist() == expected


@pytest.mark.parametrize("cells", [(3, 3, 2), (9, 9, 2), (5, 4, 6)])
def test_order_of_elimination_does_not_change_the_solution_beyond_rounding(cells: tuple[int, int, int]) -> None:
    """The same matrix in the planned order and in the order of the mesh's node numbers."""
    planned = box_gel((0.02, 0.015, 0.01), cells).elimination
    count = len(planned.nodes)
    numbered = Elimination(
        planned.nodes[np.argsort(planned.nodes)],
        np.argsort(np.argsort(planned.nodes))[planned.edges],
        np.array([0, count]),
        (np.empty(0, dtype=np.int64),),
    )
    random = np.random.default_rng(1)
    layouts = [system_layout([part], 4) for part in (planned, numbered)]
    orders = [
        np.concatenate([np.argsort(np.argsort(part.nodes)), count + np.arange(4)]) for part in (planned, numbered)
    ]
    total = count + 4
    pattern = dense_matrix(layouts[1], np.ones(layouts[1].size))
    values = random.normal(size=(3 * total, 3 * total)) * pattern + 60 * np.sqrt(total) * np.eye(3 * total)
    rhs = random.normal(size=(total, 3))
    answers = []
    for layout, order in zip(layouts, orders, strict=True):
        entries = np.zeros(layout.size)
        blocks = values.reshape(total, 3, total, 3).transpose(0, 2, 1, 3)
        for a in range(total):
            for b in range(total):
                if system_place(layout, a, b)[0] != NO_PLACE:
                    fill(layout, entries, a, b, blocks[order[a], order[b]])
        x = np.empty((total, 3))
        x[order] = solution(layout, entries, rhs[order].ravel()).reshape(total, 3)
        answers.append(x)
    np.testing.assert_allclose(answers[0], answers[1], rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("seed", range(8))
def test_positive_flag_tells_definite_from_indefinite_matrices(seed: int) -> None:
    for shift in (60.0, 1.0, -60.0):
        layout, entries = random_system(seed, (8, 5), 2, symmetric=True, shift=shift)
        definite = bool(np.linalg.eigvalsh(dense_matrix(layout, entries)).min() > 0)
        assert factorise(layout, entries, new_factor(layout), True) is definite


@pytest.mark.parametrize("seed", range(8))
def test_sign_of_the_determinant_is_that_of_dense_linear_algebra(seed: int) -> None:
    for shift in (60.0, 1.0, -60.0):
        layout, entries = random_system(seed, (8, 4), 3, shift=shift)
        negative = bool(np.linalg.slogdet(dense_matrix(layout, entries))[0] < 0)
        assert has_negative_determinant(factors(layout, entries)) is negative


@pytest.mark.parametrize("node", [3, 9])
def test_a_singular_matrix_is_reported(node: int) -> None:
    """Node 3 is a gel's, node 9 a frame point."""
    layout, entries = random_system(0, (8,), 2)
    for other in range(10):
        for a, b in ((node, other), (other, node)):
            place, stride = system_place(layout, a, b)
            if place != NO_PLACE:
                for k in range(3):
                    entries[place + k * stride : place + k * stride + 3] = 0
    assert not factorise(layout, entries, new_factor(layout), False)


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), nodes=st.integers(1, 250))
def test_order_is_a_permutation_that_does_not_depend_on_the_order_of_edges(seed: int, nodes: int) -> None:
    random = np.random.default_rng(seed)
    edges, positions = random_graph(random, nodes, min(1.0, 3 / nodes)), random.random((nodes, 3))
    order = elimination_order(edges, positions)
    assert sorted(order.tolist()) == list(range(nodes))
    shuffled = random.permutation(edges)[:, ::-1] if len(edges) else edges
    np.testing.assert_array_equal(elimination_order(shuffled, positions), order)


def test_minimum_degree_takes_the_leaves_of_a_star_before_its_centre() -> None:
    neighbours = [{1, 2, 3, 4}, {0}, {0}, {0}, {0}]
    assert minimum_degree([0, 1, 2, 3, 4], neighbours)[:3] == [1, 2, 3]


@settings(max_examples=30)
@given(seed=st.integers(0, 10**6), nodes=st.integers(2, 20))
def test_elimination_never_reaches_further_than_a_front_says(seed: int, nodes: int) -> None:
    random = np.random.default_rng(seed)
    plan = random_elimination(random, nodes)
    matrix = np.eye(nodes) * 20
    for a, b in plan.edges:
        matrix[a, b], matrix[b, a] = random.normal(size=2)
    for first, stop, rows in zip(plan.first, plan.first[1:], plan.rows, strict=False):
        for k in range(first, stop):
            reached = np.flatnonzero((np.abs(matrix[k, :]) > 1e-14) | (np.abs(matrix[:, k]) > 1e-14))
            assert {int(r) for r in reached if r >= stop} <= set(rows.tolist())
            matrix[k + 1 :, k:] -= np.outer(matrix[k + 1 :, k] / matrix[k, k], matrix[k, k:])


def test_work_of_a_sheet_grows_like_the_three_halves_power_of_its_nodes() -> None:
    """Nested dissection of a square grid; a band would need the second power."""

    def operations(cells: int) -> float:
        plan = box_gel((0.03, 0.03, 0.002), (cells, cells, 1)).elimination
        sizes = np.diff(plan.first) + np.array([len(rows) for rows in plan.rows])
        return float((np.diff(plan.first) * sizes**2).sum())

    assert operations(48) / operations(24) < 4**1.75


def test_a_plan_covers_the_free_nodes_of_its_mesh() -> None:
    mesh = box_gel((0.02, 0.006, 0.004), (10, 3, 2))
    assert sorted(mesh.elimination.nodes.tolist()) == np.flatnonzero(~mesh.driven).tolist()


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    sizes=st.lists(st.integers(1, 20), min_size=1, max_size=2),
    border=st.integers(0, 4),
    symmetric=st.booleans(),
)
def test_negative_curvature_direction_leaves_only_the_last_negative_pivots_force(
    seed: int, sizes: list[int], border: int, symmetric: bool
) -> None:
    layout, entries = random_system(seed, tuple(sizes), border, symmetric=symmetric, shift=3.0)
    matrix = dense_matrix(layout, entries)
    factor, x = factors(layout, entries), np.ones(len(matrix))
    negative_curvature_direction(layout, factor, x)
    if factor.negative_pivots[0] == 0:
        np.testing.assert_array_equal(x, 0.0)
        return
    last = np.flatnonzero(x)[-1]
    forces = matrix @ x
    assert x[last] == pytest.approx(1.0)
    np.testing.assert_allclose(forces[:last], 0.0, atol=1e-6 * np.abs(matrix).max() * np.abs(x).max())
    assert forces[last] < 0.0
    assert x @ forces == pytest.approx(forces[last], rel=1e-6)
