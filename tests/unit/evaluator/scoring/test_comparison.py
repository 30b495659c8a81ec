from dataclasses import dataclass, replace

import pytest
from evaluation_records import make_record
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.scoring.comparison import Comparison, NothingToCompare, adjust_p_values, compare_tasks


@dataclass(frozen=True, kw_only=True)
class End:
    """An episode as a comparison reads it."""

    episode: int
    success: bool
    task: str = "peg-insertion"
    shape: str = "cuboid"
    initial_offset: tuple[float, ...] = ()
    env_steps: int = 4

    @property
    def outcome(self) -> str:
        return "success" if self.success else "tactile"


def ends(solved: str, task: str = "peg-insertion", repeats: int = 1) -> list[End]:
    """Episodes 1 to n, each character `x` a success, and so many of one start after each other."""
    return [
        End(episode=number, success=mark == "x", task=task, initial_offset=((number - 1) // repeats,))
        for number, mark in enumerate(solved, 1)
    ]


def counts(comparison: Comparison) -> tuple[int, int, int, int]:
    return comparison.both, comparison.only_first, comparison.only_second, comparison.neither


def test_episodes_are_paired_by_their_number_in_any_order() -> None:
    comparison = compare_tasks(reversed(ends("xx..x")), ends("x.x.x"))["peg-insertion"]
    assert [(pair.first.episode, pair.second.episode) for pair in comparison.pairs] == [(n, n) for n in range(1, 6)]
    assert counts(comparison) == (2, 1, 1, 1)
    assert comparison.unpaired == 0
    assert comparison.p_value == 1.0


def test_equal_numbers_of_other_tasks_are_no_pair() -> None:
    compared = compare_tasks([*ends("xx"), *ends("..", "lock-opening")], [*ends(".x"), *ends("xx", "lock-opening")])
    assert {task: counts(comparison) for task, comparison in compared.items()} == {
        "lock-opening": (0, 0, 2, 0),
        "peg-insertion": (1, 1, 0, 0),
    }


def test_episodes_that_only_one_has_do_not_count() -> None:
    comparison = compare_tasks(ends("xxxx"), ends(".x"))["peg-insertion"]
    assert len(comparison.pairs) == 2
    assert comparison.unpaired == 2
    assert counts(comparison) == (1, 1, 0, 0)


def test_trials_from_other_starts_are_no_pair() -> None:
    """A station whose hole is wider has replaced the second start."""
    replaced = [replace(end, initial_offset=(8.0,)) if end.episode == 2 else end for end in ends("x.x")]
    comparison = compare_tasks(ends("xxx"), replaced)["peg-insertion"]
    assert [pair.first.episode for pair in comparison.pairs] == [1, 3]
    assert (comparison.unpaired, comparison.difference) == (1, 0.0)


@pytest.mark.parametrize("second", [[], ends("x", "lock-opening"), [End(episode=1, success=True)]])
def test_nothing_in_common_is_refused(second: list[End]) -> None:
    with pytest.raises(NothingToCompare, match="2 and"):
        compare_tasks(ends("x."), second)


def test_records_can_be_compared() -> None:
    won, lost = make_record(3), make_record(3, outcome=EpisodeOutcome.TACTILE)
    assert counts(compare_tasks([won], [lost])["peg-insertion"]) == (0, 1, 0, 0)


def test_pairs_of_a_start_count_once_for_the_p_value() -> None:
    alone = compare_tasks(ends("xxxxxx"), ends("......"))["peg-insertion"]
    repeated = compare_tasks(ends("xxxxxx", repeats=3), ends("......", repeats=3))["peg-insertion"]
    assert (alone.p_value, repeated.p_value) == (2 / 2**6, 2 / 2**2)
    assert repeated.interval[0] < alone.interval[0] < alone.difference == 1.0


def test_several_p_values_are_adjusted_as_holm_does() -> None:
    assert adjust_p_values([0.04, 0.01, 0.03]) == pytest.approx([0.06, 0.03, 0.06])
    assert adjust_p_values([0.6, 0.9]) == [1.0, 1.0]
    assert adjust_p_values([0.02]) == [0.02]
