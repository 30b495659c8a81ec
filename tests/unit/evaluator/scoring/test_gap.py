"""The gap between simulation and a station, against sums by hand and scipy."""

import numpy as np
import pytest
from scipy.stats import pearsonr
from vitac.evaluator.scoring.comparison import paired_interval
from vitac.evaluator.scoring.gap import Gap, NoGap, PlayedTwice, measure_gap

EPISODES = range(1, 13)
# Three repeats of four starts.
STARTS = {episode: (episode - 1) % 4 for episode in EPISODES}


def played(name: str, simulation: int, station: int) -> PlayedTwice:
    """A policy that solves the first so many of twelve episodes."""
    return PlayedTwice(name=name, ends={episode: (episode <= simulation, episode <= station) for episode in EPISODES})


def gap_of(*counts: tuple[int, int]) -> Gap:
    return measure_gap([played(f"policy {k}", *count) for k, count in enumerate(counts)], STARTS)


def test_rates_differences_and_agreement_are_those_of_the_counts() -> None:
    gap = gap_of((12, 9), (6, 3), (3, 6))
    assert [(each.simulation, each.station) for each in gap.policies] == [(1.0, 0.75), (0.5, 0.25), (0.25, 0.5)]
    assert [(each.both, each.only_simulation, each.only_station, each.neither) for each in gap.policies] == [
        (9, 3, 0, 0), (3, 3, 0, 6), (3, 0, 3, 6),
    ]  # fmt: skip
    assert gap.difference.value == pytest.approx((0.25 + 0.25 - 0.25) / 3)
    assert gap.agreement.value == pytest.approx(27 / 36)
    for measured in (gap.difference, gap.agreement):
        assert measured.low < measured.value < measured.high


def test_correlation_is_scipys() -> None:
    counts = [(12, 9), (10, 10), (6, 3), (3, 6), (1, 0)]
    measured = gap_of(*counts).pearson
    assert measured is not None
    assert measured.value == pytest.approx(pearsonr(*np.array(counts).T).statistic)


def test_rank_violation_is_the_largest_difference_that_simulation_ranks_otherwise() -> None:
    """Of the policies B and C, whose order simulation turns round: 0.25 each; A is ranked right: 0."""
    measured = gap_of((12, 9), (6, 3), (3, 6)).mean_maximum_rank_violation
    assert measured is not None
    assert measured.value == pytest.approx((0.0 + 0.25 + 0.25) / 3)
    ranked = gap_of((12, 9), (6, 6), (3, 3)).mean_maximum_rank_violation
    assert ranked is not None
    assert ranked.value == 0.0


def test_repeats_of_a_start_narrow_no_interval() -> None:
    """With one start for all episodes, nothing but the rate itself is drawn."""
    policy = played("one", 6, 3)
    apart = measure_gap([policy], {episode: episode for episode in EPISODES}).difference
    alike = measure_gap([policy], dict.fromkeys(EPISODES, 0)).difference
    assert apart.low < alike.low == alike.high < apart.high


def test_difference_of_a_policy_has_the_interval_of_compare() -> None:
    (policy,) = gap_of((6, 3)).policies
    by_start = [
        [1 if 3 < episode <= 6 else 0 for episode in EPISODES if STARTS[episode] == start] for start in range(4)
    ]
    assert (policy.difference.low, policy.difference.high) == pytest.approx(paired_interval(by_start))


def test_one_policy_has_no_correlation_and_equal_rates_have_none() -> None:
    one = gap_of((6, 3))
    assert (one.pearson, one.mean_maximum_rank_violation) == (None, None)
    assert one.by_chance.mean_maximum_rank_violation is None
    assert gap_of((6, 3), (6, 9)).pearson is None


def test_the_same_files_give_the_same_figures() -> None:
    assert gap_of((12, 9), (6, 3)) == gap_of((12, 9), (6, 3))


def test_chance_alone_violates_ranks_by_as_much_as_few_episodes_tell_policies_apart() -> None:
    """Two policies of one true rate of a half: their order turns round by chance, and more episodes show less."""
    few = gap_of((6, 6), (6, 6)).by_chance
    many = {episode: (episode % 2 == 0, episode % 2 == 0) for episode in range(1, 1201)}
    policies = [PlayedTwice(name=name, ends=many) for name in ("one", "other")]
    more = measure_gap(policies, {episode: episode for episode in many}).by_chance
    # The difference of two rates of 12 episodes has a standard deviation of 0.2; 5 % of its sizes are above twice that.
    assert few.mean_maximum_rank_violation is not None
    assert 0.33 <= few.mean_maximum_rank_violation <= 0.42
    assert few.difference == pytest.approx(1.96 * (2 * 0.25 / 12 / 2) ** 0.5, abs=0.05)
    assert more.mean_maximum_rank_violation == pytest.approx(few.mean_maximum_rank_violation / 10, rel=0.2)


def test_nothing_in_common_is_refused() -> None:
    with pytest.raises(NoGap, match="Expected episodes of nobody that simulation and station have both played"):
        measure_gap([PlayedTwice(name="nobody", ends={})], {})
    with pytest.raises(NoGap, match="Expected a policy that was played"):
        measure_gap([], {})
