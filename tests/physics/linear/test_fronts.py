"""The planned fronts against the elimination that they stand for, done node by node on small graphs."""

import numpy as np
import pytest
from block_meshes import box_gel
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from vitac.envs.fem.linear.ordering import Elimination, plan_elimination

IndexArray = NDArray[np.int64]
Graph = tuple[int, list[tuple[int, int]]]


@st.composite
def graphs(draw: st.DrawFn) -> Graph:
    count = draw(st.integers(1, 14))
    pairs = [(a, b) for a in range(count) for b in range(a)]
    return count, draw(st.lists(st.sampled_from(pairs), unique=True)) if pairs else []


def planned(graph: Graph) -> Elimination:
    count, pairs = graph
    positions_m = np.random.default_rng(count).uniform(size=(count, 3))
    edges = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    return plan_elimination(np.arange(count), edges, positions_m)


def fronts_of(plan: Elimination) -> list[tuple[list[int], list[int]]]:
    """The pivots of each front and the places after them that it reaches."""
    bounds = plan.first.tolist()
    return [
        (list(range(first, after)), rows.tolist())
        for first, after, rows in zip(bounds[:-1], bounds[1:], plan.rows, strict=True)
    ]


def filled(plan: Elimination) -> list[set[int]]:
    """The later places that each place is coupled to when it is eliminated, found by eliminating one by one."""
    coupled: list[set[int]] = [set() for _ in plan.nodes]
    for a, b in plan.edges.tolist():
        coupled[a].add(b)
        coupled[b].add(a)
    for place, others in enumerate(coupled):
        later = {other for other in others if other > place}
        for other in later:
            coupled[other] |= later - {other}
        coupled[place] = later
    return coupled


@given(graphs())
def test_every_node_is_a_pivot_once(graph: Graph) -> None:
    plan = planned(graph)
    assert sorted(plan.nodes.tolist()) == list(range(graph[0]))
    assert [pivot for pivots, _ in fronts_of(plan) for pivot in pivots] == list(range(graph[0]))
    assert all(pivots for pivots, _ in fronts_of(plan))


@given(graphs())
def test_edges_are_the_given_ones_between_places(graph: Graph) -> None:
    plan = planned(graph)
    nodes = plan.nodes.tolist()
    found = {frozenset((nodes[a], nodes[b])) for a, b in plan.edges.tolist()}
    assert found == {frozenset(pair) for pair in graph[1]}
    assert len(plan.edges) == len(graph[1])


@given(graphs())
def test_a_front_reaches_all_that_its_pivots_are_coupled_to(graph: Graph) -> None:
    plan = planned(graph)
    later = filled(plan)
    for pivots, rows in fronts_of(plan):
        assert rows == sorted(set(rows))
        assert not rows or rows[0] > pivots[-1]
        needed = set().union(*(later[pivot] for pivot in pivots)) - set(pivots)
        assert needed == set(rows)


@given(graphs())
def test_what_is_left_of_a_front_fits_into_its_parents(graph: Graph) -> None:
    """The parent is the front of the first place that a front reaches; nothing is passed on to any other."""
    fronts = fronts_of(planned(graph))
    owner = {pivot: number for number, (pivots, _) in enumerate(fronts) for pivot in pivots}
    for number, (_, rows) in enumerate(fronts):
        if rows:
            parent = owner[rows[0]]
            pivots, reached = fronts[parent]
            assert parent > number
            assert set(rows) <= set(pivots) | set(reached)


@settings(max_examples=25)
@given(graphs(), st.randoms(use_true_random=False))
def test_the_order_of_the_edges_and_of_their_ends_changes_nothing(graph: Graph, random: object) -> None:
    count, pairs = graph
    turned = [pair[::-1] if index % 2 else pair for index, pair in enumerate(pairs)]
    random.shuffle(turned)  # type: ignore[attr-defined]
    ours, theirs = planned(graph), planned((count, turned))
    assert ours.nodes.tolist() == theirs.nodes.tolist()
    assert ours.first.tolist() == theirs.first.tolist()
    assert [rows.tolist() for rows in ours.rows] == [rows.tolist() for rows in theirs.rows]


def test_nodes_that_are_not_coupled_make_fronts_of_their_own() -> None:
    plan = planned((3, []))
    assert [len(pivots) for pivots, _ in fronts_of(plan)] == [1, 1, 1]
    assert [rows for _, rows in fronts_of(plan)] == [[], [], []]


def test_a_whole_graph_of_few_nodes_is_one_front() -> None:
    plan = planned((6, [(a, b) for a in range(6) for b in range(a)]))
    assert fronts_of(plan) == [(list(range(6)), [])]


@pytest.mark.parametrize("cells", [(1, 1, 2), (2, 2, 2), (3, 2, 4)])
def test_the_plan_of_a_mesh_names_its_free_nodes(cells: tuple[int, int, int]) -> None:
    gel = box_gel((0.006, 0.005, 0.004), cells)
    plan = gel.elimination
    assert sorted(plan.nodes.tolist()) == np.flatnonzero(~gel.driven).tolist()
    within = {
        tuple(sorted(pair)) for row in gel.tetrahedra.tolist() for pair in zip(row, row[1:] + row[:1], strict=True)
    }
    coupled = {tuple(sorted(plan.nodes[list(edge)].tolist())) for edge in plan.edges.tolist()}
    assert {pair for pair in within if not gel.driven[list(pair)].any()} <= coupled
    assert not any(gel.driven[list(pair)].any() for pair in coupled)
