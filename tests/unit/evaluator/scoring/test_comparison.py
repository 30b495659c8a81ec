from dataclasses import dataclass

import pytest
from evaluation_records import make_record
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.scoring.comparison import Comparison, NothingToCompare, compare, mcnemar_p_value


@dataclass(frozen=True, kw_only=True)
class End:
    """An episode as a comparison reads it."""

    episode: int
    success: bool
    task: str = "peg-insertion"
    shape: str = "cuboid"
    env_steps: int = 4

    @property
    def outcome(self) -> str:
        return "success" if self.success else "tactile"


def ends(solved: str, task: str = "peg-insertion") -> list[End]:
    """Episodes 1 to n, each character `x` a success."""
    return [End(episode=number, success=mark == "x", task=task) for number, mark in enumerate(solved, 1)]


def counts(comparison: Comparison) -> tuple[int, int, int, int]:
    return comparison.both, comparison.only_first, comparison.only_second, comparison.neither


def test_episodes_are_paired_by_their_number_in_any_order() -> None:
    comparison = compare(reversed(ends("xx..x")), ends("x.x.x"))
    assert [(pair.first.episode, pair.second.episode) for pair in comparison.pairs] == [(n, n) for n in range(1, 6)]
    assert counts(comparison) == (2, 1, 1, 1)
    assert comparison.unpaired == 0
    assert comparison.p_value == 1.0


def test_equal_numbers_of_other_tasks_are_no_pair() -> None:
    comparison = compare([*ends("xx"), *ends("..", "lock-opening")], [*ends(".x"), *ends("xx", "lock-opening")])
    assert counts(comparison) == (1, 1, 2, 0)


def test_episodes_that_only_one_has_do_not_count() -> None:
    comparison = compare(ends("xxxx"), ends(".x"))
    assert len(comparison.pairs) == 2
    assert comparison.unpaired == 2
    assert counts(comparison) == (1, 1, 0, 0)


@pytest.mark.parametrize("second", [[], ends("x", "lock-opening")])
def test_nothing_in_common_is_refused(second: list[End]) -> None:
    with pytest.raises(NothingToCompare, match="2 and"):
        compare(ends("x."), second)


def test_records_can_be_compared() -> None:
    won, lost = make_record(3), make_record(3, outcome=EpisodeOutcome.TACTILE)
    assert counts(compare([won], [lost])) == (0, 1, 0, 0)


@given(st.integers(0, 300), st.integers(0, 300))
def test_p_value_is_the_binomial_tests(only_first: int, only_second: int) -> None:
    from scipy.stats import binomtest

    differing = only_first + only_second
    expected = binomtest(only_first, differing, 0.5).pvalue if differing else 1.0
    assert mcnemar_p_value(only_first, only_second) == pytest.approx(expected, rel=1e-9)


def test_p_value_does_not_depend_on_which_is_named_first() -> None:
    assert mcnemar_p_value(3, 11) == mcnemar_p_value(11, 3) == pytest.approx(0.057373, abs=1e-6)


def test_p_value_of_very_many_episodes_is_a_number() -> None:
    assert mcnemar_p_value(5000, 5000) == 1.0
    assert mcnemar_p_value(0, 5000) == 0.0  # 2^-4999 is less than the smallest number
    assert 0 < mcnemar_p_value(2400, 2600) < 0.01
