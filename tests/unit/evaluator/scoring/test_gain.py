import pytest
from evaluation_records import make_record
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord
from vitac.evaluator.scoring.comparison import RunsDiffer, paired_interval, sensing_gain


def runs(text: str) -> list[EpisodeRecord]:
    """Records of episodes that end as the letters say: s for success, t for tactile."""
    outcomes = {"s": EpisodeOutcome.SUCCESS, "t": EpisodeOutcome.TACTILE}
    return [make_record(number, outcome=outcomes[letter]) for number, letter in enumerate(text, start=1)]


def independent(only_first: int, only_second: int, pairs: int) -> list[list[int]]:
    """Differences of pairs that all have starts of their own."""
    differing = [[1]] * only_first + [[-1]] * only_second
    return differing + [[0]] * (pairs - len(differing))


def test_gain_is_the_difference_of_the_rates() -> None:
    gain = sensing_gain(runs("sssst"), runs("tsttt"))
    assert (gain.episodes, gain.standard_successes, gain.blind_successes) == (5, 4, 1)
    assert gain.gain == pytest.approx(0.6)
    assert gain.p_value == pytest.approx(0.25)
    assert gain.low < 0.6 < gain.high


def test_order_of_the_records_does_not_matter() -> None:
    assert sensing_gain(runs("sstt")[::-1], runs("stst")) == sensing_gain(runs("sstt"), runs("stst")[::-1])


@pytest.mark.parametrize(("standard", "blind"), [("ss", "s"), ("", ""), ("s", "ss")])
def test_runs_of_other_episodes_are_refused(standard: str, blind: str) -> None:
    with pytest.raises(RunsDiffer, match="same episodes"):
        sensing_gain(runs(standard), runs(blind))


def test_interval_is_the_published_one() -> None:
    # b = 4, c = 9 of 100: centre -5 / 102, half width 1.96 sqrt(14 - 25 / 102) / 102.
    assert paired_interval(independent(4, 9, 100)) == pytest.approx((-0.120290, 0.022251), abs=1e-5)


@given(st.integers(0, 50), st.integers(0, 50), st.integers(0, 50))
def test_interval_lies_in_range_and_turns_round_with_the_runs(only_first: int, only_second: int, same: int) -> None:
    pairs = only_first + only_second + same
    if pairs == 0:
        return
    low, high = paired_interval(independent(only_first, only_second, pairs))
    assert -1.0 <= low <= high <= 1.0
    assert paired_interval(independent(only_second, only_first, pairs)) == pytest.approx((-high, -low))


def test_no_difference_is_not_taken_as_certain() -> None:
    low, high = paired_interval(independent(0, 0, 270))
    assert low < 0.0 < high
