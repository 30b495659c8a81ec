from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.scoring.score import wilson_interval
from vitac.server.leaderboards.standings import rank_ranges

counts = st.lists(st.integers(0, 50), max_size=20).map(lambda successes: sorted(successes, reverse=True))


def intervals(successes: list[int]) -> list[tuple[float, float]]:
    found = [wilson_interval(count, 50) for count in successes]
    return [(interval.low, interval.high) for interval in found]


def test_entries_that_cannot_be_told_apart_share_their_ranks() -> None:
    assert rank_ranges([(0.8, 0.9), (0.5, 0.7), (0.6, 0.75), (0.1, 0.2)]) == [(1, 1), (2, 3), (2, 3), (4, 4)]
    assert rank_ranges([]) == []
    assert rank_ranges([(0.5, 0.6)] * 3) == [(1, 3)] * 3


@given(counts)
def test_the_own_rank_lies_in_the_range(successes: list[int]) -> None:
    for rank, (first, last) in enumerate(rank_ranges(intervals(successes)), start=1):
        assert 1 <= first <= rank <= last <= len(successes)


@given(counts)
def test_the_range_counts_who_is_certainly_ahead_and_behind(successes: list[int]) -> None:
    drawn = intervals(successes)
    for (low, high), (first, last) in zip(drawn, rank_ranges(drawn), strict=True):
        assert first == 1 + sum(other_low > high for other_low, _ in drawn)
        assert last == len(drawn) - sum(other_high < low for _, other_high in drawn)
