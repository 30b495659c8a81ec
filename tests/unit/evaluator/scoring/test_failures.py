import random
from collections.abc import Mapping
from dataclasses import replace

import pytest
from evaluation_fakes import small_track
from evaluation_records import make_failure, make_record
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord, FailureStage, PolicyFailure
from vitac.evaluator.scoring.score import FAILURES_THAT_END_A_SHARD, breaking_failure, is_broken
from vitac.evaluator.tracks.definition import cut

SHARDS = cut(small_track().tasks["peg-insertion"])
FIRST, SECOND = sorted(SHARDS[0].numbers), sorted(SHARDS[1].numbers)
CRASH = make_failure()
NO_LOAD = make_failure(stage=FailureStage.LOAD, code=VerdictCode.IMPORT_ERROR)
NO_TIME = make_failure(code=VerdictCode.SHARD_TIME)


def records(failures: Mapping[int, PolicyFailure]) -> list[EpisodeRecord]:
    """All episodes of both shards; those named failed, the others succeeded."""
    return [
        make_record(number, EpisodeOutcome.POLICY_FAILED, 0, failure=failures[number])
        if number in failures
        else make_record(number)
        for number in (*FIRST, *SECOND)
    ]


def numbered(numbers: list[int]) -> dict[int, PolicyFailure]:
    """A crash in each of these episodes, with its number in the message."""
    return {number: make_failure(message=f"episode {number}") for number in numbers}


def test_shards_are_large_enough_for_these_tests() -> None:
    assert min(len(FIRST), len(SECOND)) >= FAILURES_THAT_END_A_SHARD


@pytest.mark.parametrize("failure", [NO_LOAD, NO_TIME])
def test_a_shard_of_which_nothing_more_can_be_played_is_broken_by_one_failure(failure: PolicyFailure) -> None:
    assert is_broken([failure])
    assert is_broken([CRASH, failure])
    assert not is_broken([CRASH, CRASH])


def test_failures_spread_over_shards_end_nothing() -> None:
    assert breaking_failure(SHARDS, records(numbered([*FIRST[:2], *SECOND[:2]]))) is None


def test_the_first_failure_of_a_broken_shard_ends_the_evaluation() -> None:
    failure = breaking_failure(SHARDS, records(numbered(FIRST[-3:])))
    assert failure == make_failure(message=f"episode {FIRST[-3]}")


def test_the_first_broken_shard_decides_whatever_the_order_of_shards() -> None:
    failures = numbered([*FIRST[:3], *SECOND[:3]])
    for shards in (SHARDS, SHARDS[::-1]):
        assert breaking_failure(shards, records(failures)) == failures[FIRST[0]]


def test_an_earlier_shard_that_is_not_broken_does_not_decide() -> None:
    failures = numbered([*FIRST[:2], *SECOND[:3]])
    assert breaking_failure(SHARDS, records(failures)) == failures[SECOND[0]]


@pytest.mark.parametrize("ending", [NO_LOAD, NO_TIME])
def test_the_failure_that_ended_a_shard_goes_before_earlier_ones(ending: PolicyFailure) -> None:
    assert breaking_failure(SHARDS, records({FIRST[0]: CRASH, FIRST[1]: ending})) == ending
    assert breaking_failure(SHARDS, records({**numbered(FIRST[:3]), FIRST[3]: ending})) == ending


def test_an_evaluation_without_failures_has_none() -> None:
    assert breaking_failure(SHARDS, records({})) is None
    assert breaking_failure(SHARDS, []) is None


@given(st.sets(st.sampled_from([*FIRST, *SECOND])), st.randoms())
def test_the_same_failure_decides_in_any_order_of_records(failed: set[int], shuffler: random.Random) -> None:
    played = records(numbered(sorted(failed)))
    shuffled = list(played)
    shuffler.shuffle(shuffled)
    assert breaking_failure(SHARDS, shuffled) == breaking_failure(SHARDS, played)


def test_the_lowest_number_decides_and_not_the_order_of_a_set() -> None:
    numbers = [1, 8, 16, 33]
    assert list(set(numbers)) != numbers
    episodes = [replace(episode, number=number) for episode, number in zip(SHARDS[0].episodes, numbers, strict=False)]
    failures = numbered(numbers)
    played = [make_record(number, EpisodeOutcome.POLICY_FAILED, 0, failure=failures[number]) for number in numbers]
    assert breaking_failure([replace(SHARDS[0], episodes=tuple(episodes))], played) == failures[1]
