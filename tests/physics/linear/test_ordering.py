"""The order of elimination: complete, repeatable, and as good as is known for graphs with a known best order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from vitac.envs.fem.linear.ordering import elimination_order, minimum_degree, plan_elimination

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]
Graph = tuple[IndexArray, FloatArray]


def path(count: int) -> Graph:
    numbers = np.arange(count)
    return np.column_stack([numbers[:-1], numbers[1:]]), 1e-3 * numbers[:, None] * np.array([1.0, 0.0, 0.0])


def grid(cells: int) -> Graph:
    numbers = np.arange(cells * cells).reshape(cells, cells)
    across = np.stack([numbers[:, :-1], numbers[:, 1:]], axis=-1).reshape(-1, 2)
    along = np.stack([numbers[:-1], numbers[1:]], axis=-1).reshape(-1, 2)
    y, x = np.divmod(numbers.ravel(), cells)
    return np.concatenate([across, along]), 1e-3 * np.column_stack([x, y, 0 * x]).astype(np.float64)


def fill(edges: IndexArray, order: list[int]) -> int:
    """Couplings that elimination in this order adds, found by carrying it out."""
    neighbours: dict[int, set[int]] = {node: set() for node in order}
    for a, b in edges.tolist():
        neighbours[a].add(b)
        neighbours[b].add(a)
    added = 0
    for node in order:
        others = neighbours.pop(node)
        for other in others:
            neighbours[other].discard(node)
            added += len(others - neighbours[other] - {other})
            neighbours[other] |= others - {other}
    return added // 2


def sets(edges: IndexArray, count: int) -> list[set[int]]:
    neighbours: list[set[int]] = [set() for _ in range(count)]
    for a, b in edges.tolist():
        neighbours[a].add(b)
        neighbours[b].add(a)
    return neighbours


@pytest.mark.parametrize("graph", [path(5), path(300), grid(4), grid(18)])
def test_every_node_is_eliminated_once(graph: Graph) -> None:
    assert sorted(elimination_order(*graph).tolist()) == list(range(len(graph[1])))


def test_a_path_is_eliminated_without_fill_by_minimum_degree() -> None:
    edges, positions_m = path(60)
    assert fill(edges, elimination_order(edges, positions_m).tolist()) == 0


def test_a_star_loses_its_middle_last() -> None:
    edges = np.array([[7, other] for other in range(7)])
    order = minimum_degree(list(range(8)), sets(edges, 8))
    # With one leaf left, leaf and middle have one neighbour each, and the smaller number is first.
    assert order == [0, 1, 2, 3, 4, 5, 6, 7]
    assert fill(edges, order) == 0


def test_nodes_without_neighbours_come_in_the_order_of_their_numbers() -> None:
    assert minimum_degree([4, 2, 9], [set()] * 10) == [2, 4, 9]


def test_neighbours_outside_of_the_part_count_as_coupled() -> None:
    # Node 0 has one neighbour in the part, node 1 three outside.
    neighbours: list[set[int]] = [{1}, {0, 3, 4, 5}, set(), {1}, {1}, {1}]
    assert minimum_degree([1, 2, 0], neighbours) == [2, 0, 1]


@settings(max_examples=15)
@given(st.integers(0, 10**6))
def test_order_does_not_depend_on_the_order_or_direction_of_edges(seed: int) -> None:
    random = np.random.default_rng(seed)
    edges, positions_m = grid(12)
    shuffled = edges[random.permutation(len(edges))]
    turned = np.where(random.random((len(edges), 1)) < 0.5, shuffled, shuffled[:, ::-1])
    np.testing.assert_array_equal(elimination_order(turned, positions_m), elimination_order(edges, positions_m))


def test_order_does_not_depend_on_the_size_of_the_mesh() -> None:
    edges, positions_m = grid(14)
    expected = elimination_order(edges, positions_m)
    np.testing.assert_array_equal(elimination_order(edges, 2.0 * positions_m), expected)


def test_nested_dissection_fills_a_sheet_much_less_than_row_by_row() -> None:
    edges, positions_m = grid(24)
    dissected = fill(edges, elimination_order(edges, positions_m).tolist())
    assert dissected < 0.5 * fill(edges, list(range(24 * 24)))


def test_the_separator_of_a_large_part_comes_last() -> None:
    """Without the nodes eliminated last the sheet falls apart."""
    edges, positions_m = grid(16)
    order = elimination_order(edges, positions_m).tolist()
    left = set(order[:-16])
    reached, waiting = {order[0]}, [order[0]]
    neighbours = sets(edges, 256)
    while waiting:
        for other in neighbours[waiting.pop()] & left - reached:
            reached.add(other)
            waiting.append(other)
    assert 0.25 * len(left) < len(reached) < 0.75 * len(left)


def test_nodes_all_in_one_place_are_still_ordered() -> None:
    edges, positions_m = path(150)
    assert sorted(elimination_order(edges, 0.0 * positions_m).tolist()) == list(range(150))


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 40))
def test_a_plan_is_the_same_for_a_mesh_whose_edges_are_shuffled(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    edges = np.array([(i, j) for i in range(count) for j in range(i) if random.random() < 0.2]).reshape(-1, 2)
    edges, positions_m, nodes = edges.astype(np.int64), random.random((count, 3)), np.arange(100, 100 + count)
    plan = plan_elimination(nodes, edges, positions_m)
    again = plan_elimination(nodes, edges[random.permutation(len(edges))], positions_m)
    np.testing.assert_array_equal(plan.nodes, again.nodes)
    np.testing.assert_array_equal(plan.first, again.first)
    assert [rows.tolist() for rows in plan.rows] == [rows.tolist() for rows in again.rows]


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 40))
def test_edges_of_a_plan_are_those_of_the_mesh_in_the_new_numbers(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    edges = np.array([(i, j) for i in range(count) for j in range(i) if random.random() < 0.2]).reshape(-1, 2)
    nodes = random.permutation(1000)[:count]
    plan = plan_elimination(nodes, edges.astype(np.int64), random.random((count, 3)))
    expected = {frozenset(pair) for pair in nodes[edges.astype(np.int64)].tolist()}
    assert {frozenset(pair) for pair in plan.nodes[plan.edges].tolist()} == expected
    assert sorted(plan.nodes.tolist()) == sorted(nodes.tolist())
