from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import fisher_exact
from service_factories import make_record
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.scoring.score import better_on_public_p_value
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import EpisodeBlock, EpisodeList, Start


def make_list(shapes: str, repeats: int = 1) -> EpisodeList:
    starts = tuple(Start(shape=shape, offset=(0.0,)) for shape in shapes)
    return EpisodeList(list_seed=0, offset_option="start", blocks=(EpisodeBlock(repeats=repeats, starts=starts),))


def make_records(solved: list[bool]) -> list[EpisodeRecord]:
    return [
        make_record(number, EpisodeOutcome.SUCCESS if success else EpisodeOutcome.STEPS)
        for number, success in enumerate(solved, start=1)
    ]


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_of_starts_that_are_played_once_it_is_fishers_exact_test(solved: list[tuple[bool, bool]]) -> None:
    public, sealed = ([pair[side] for pair in solved] for side in (0, 1))
    table = np.array([[sum(public), len(public) - sum(public)], [sum(sealed), len(sealed) - sum(sealed)]])
    found = better_on_public_p_value(make_list("a" * len(solved)), make_records(public), make_records(sealed))
    assert found == pytest.approx(fisher_exact(table, alternative="greater").pvalue)


@given(st.lists(st.booleans(), min_size=24, max_size=24), st.lists(st.booleans(), min_size=24, max_size=24))
def test_whole_starts_are_divided_within_their_shape(public: list[bool], sealed: list[bool]) -> None:
    shapes, repeats = "aaabbbba", 3

    def successes(solved: list[bool], shape: str) -> list[int]:
        return [sum(solved[start::8]) for start in range(8) if shapes[start] == shape]

    observed, totals = sum(public), [0]
    for shape in "ab":
        both = successes(public, shape) + successes(sealed, shape)
        chosen = [sum(some) for some in combinations(both, len(both) // 2)]
        totals = [total + more for total in totals for more in chosen]
    found = better_on_public_p_value(make_list(shapes, repeats), make_records(public), make_records(sealed))
    assert found == pytest.approx(sum(total >= observed for total in totals) / len(totals))


def test_repeats_of_a_start_are_no_further_evidence() -> None:
    once, thrice = make_list("a" * 10), make_list("a" * 10, repeats=3)
    public, sealed = [True] * 8 + [False] * 2, [True] * 3 + [False] * 7
    p_value = better_on_public_p_value(once, make_records(public), make_records(sealed))
    assert better_on_public_p_value(thrice, make_records(public * 3), make_records(sealed * 3)) == p_value < 0.05


@pytest.mark.parametrize(("track", "task"), [("track_1", "peg-insertion"), ("track_2", "fusion-insertion")])
def test_a_table_is_told_from_a_policy_on_lists_of_full_length(track: str, task: str) -> None:
    listed = load_track(track).task(task).episode_list
    n = len(listed.starts)
    table = [number % 20 > 0 for number in range(n)], [number % 9 == 0 for number in range(n)]
    policy = [number % 5 > 0 for number in range(n)], [number % 5 > 1 or number % 7 > 0 for number in range(n)]
    assert better_on_public_p_value(listed, *map(make_records, table)) < 1e-12
    assert better_on_public_p_value(listed, *map(make_records, policy)) > 0.05
