"""The start is the unit: what repeats tell, measured on the public peg list and by independent oracles."""

import numpy as np
import pytest
from evaluation_records import make_record
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.scoring.score import rate, rate_by_start, score
from vitac.evaluator.scoring.starts import design_effect, intraclass_correlation, permutation_p_value
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import DRAWN

TRAINED = (7, 12, 14, 57)
"""Starts of the public peg list of which `peg_insertion_trained` solves none, one, two and all three repeats."""
GROUPS = [[repeat < solved for repeat in range(3)] for solved, count in enumerate(TRAINED) for _ in range(count)]


def ends(groups: list[list[bool]]) -> list[tuple[int, bool]]:
    return [(start, solved) for start, group in enumerate(groups) for solved in group]


def test_repeats_of_the_public_peg_list_tell_as_much_as_half_as_many_episodes() -> None:
    task = load_track("track_1").task("peg-insertion")
    assert len({(episode.shape, episode.offset) for episode in task.episodes}) == len(GROUPS) == 90
    assert sum(len(set(group)) == 1 for group in GROUPS) == 64
    assert intraclass_correlation(GROUPS) == pytest.approx(0.44, abs=5e-3)
    assert design_effect(GROUPS) == pytest.approx(1.88, abs=5e-3)


def test_interval_is_that_of_drawing_starts_again() -> None:
    found = rate_by_start(ends(GROUPS))
    random, sums = np.random.default_rng(0), np.array([sum(group) for group in GROUPS])
    drawn = sums[random.integers(90, size=(20_000, 90))].sum(axis=1) / 270
    low, high = np.percentile(drawn, [2.5, 97.5])  # the cluster bootstrap: 71.1 to 84.4 %
    assert (found.episodes, found.starts, found.successes) == (270, 90, 211)
    assert (found.interval.low, found.interval.high) == pytest.approx((low, high), abs=8e-3)
    assert found.interval.high - found.interval.low > 1.3 * (0.827 - 0.728)  # of 270 independent episodes


def test_score_counts_the_starts_of_its_records() -> None:
    records = [
        make_record(
            number, EpisodeOutcome.SUCCESS if solved else EpisodeOutcome.STEPS, initial_offset=(start,), shape="a"
        )
        for number, (start, solved) in enumerate(ends(GROUPS), start=1)
    ]
    assert score(records).interval == score(records).by_shape["a"].interval == rate_by_start(ends(GROUPS)).interval
    drawn = [record.model_copy(update={"shape": DRAWN}) for record in records]
    assert score(drawn).interval == rate(211, 270).interval  # no two episodes share a start


@given(st.lists(st.lists(st.booleans(), min_size=1, max_size=4), min_size=1, max_size=12))
def test_interval_holds_the_rate_and_is_never_that_of_more_than_the_episodes_or_less_than_one_start(
    groups: list[list[bool]],
) -> None:
    found, n = rate_by_start(ends(groups)), sum(map(len, groups))
    assert 0 <= intraclass_correlation(groups) <= 1
    assert 1 <= design_effect(groups) <= max(map(len, groups))
    assert found.interval.low <= found.success_rate <= found.interval.high
    assert found.interval.low <= rate(found.successes, n).interval.low + 1e-12
    assert found.interval.high >= rate(found.successes, n).interval.high - 1e-12


def test_starts_that_all_end_alike_count_once_each() -> None:
    assert rate_by_start(ends([[True] * 3] * 90)).interval == rate(90, 90).interval
    assert rate_by_start(ends([[True] * 2 + [False]] * 30)).interval == rate(60, 90).interval  # nothing in common


@given(st.integers(0, 300), st.integers(0, 300))
def test_p_value_of_independent_episodes_is_the_binomial_tests(only_first: int, only_second: int) -> None:
    from scipy.stats import binomtest

    differing = only_first + only_second
    expected = binomtest(only_first, differing, 0.5).pvalue if differing else 1.0
    assert permutation_p_value([1] * only_first + [-1] * only_second) == pytest.approx(expected, rel=1e-9)


@given(st.lists(st.integers(-3, 3), min_size=1, max_size=10))
def test_p_value_of_starts_is_the_share_of_all_signs(differences: list[int]) -> None:
    signs = np.array(np.meshgrid(*[[1, -1]] * len(differences))).reshape(len(differences), -1)
    sums = np.abs(np.array(differences) @ signs)
    assert permutation_p_value(differences) == pytest.approx(np.mean(sums >= abs(sum(differences))))


def test_p_value_of_very_many_episodes_is_a_number() -> None:
    assert permutation_p_value([1, -1] * 5000) == 1.0
    assert permutation_p_value([1] * 5000) == 0.0  # 2^-4999 is less than the smallest number
    assert 0 < permutation_p_value([1] * 2400 + [-1] * 2600) < 0.01
