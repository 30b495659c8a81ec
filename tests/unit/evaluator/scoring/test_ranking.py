import random
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from math import inf, isfinite, nan

import pytest
from evaluation_records import make_record
from hypothesis import given
from hypothesis import strategies as st
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.scoring.ranking import Standing, combine, rank
from vitac.evaluator.scoring.score import Score, interval_of_mean, score

NOON = datetime(2025, 1, 31, 12, tzinfo=UTC)

numbers = st.none() | st.sampled_from([nan, inf, -inf]) | st.floats(0, 1)
standings = st.lists(
    st.builds(
        Standing,
        id=st.uuids().map(str),
        success_rate=numbers | st.sampled_from([0.0, 0.5, 1.0]),
        mean_steps=numbers | st.sampled_from([3.0, 4.5]),
        submitted_at=st.integers(0, 3).map(lambda hours: NOON + timedelta(hours=hours)),
    ),
    unique_by=lambda standing: standing.id,
)


def standing(
    name: str = "a", success_rate: float | None = 0.5, mean_steps: float | None = 4.0, hours: int = 0
) -> Standing:
    return Standing(
        id=name, success_rate=success_rate, mean_steps=mean_steps, submitted_at=NOON + timedelta(hours=hours)
    )


def order(*entries: Standing) -> list[str]:
    return [ranked.standing.id for ranked in rank(entries)]


def test_higher_success_rate_wins_over_everything_else() -> None:
    assert order(standing("slow", 0.6, 8.0, hours=9), standing("fast", 0.5, 3.0)) == ["slow", "fast"]


def test_fewer_steps_win_a_tie() -> None:
    assert order(standing("late", mean_steps=3.0, hours=9), standing("early", mean_steps=3.1)) == ["late", "early"]


def test_earlier_submission_wins_an_equal_score() -> None:
    assert order(standing("copy", hours=1), standing("original")) == ["original", "copy"]


def test_id_decides_at_last() -> None:
    assert order(standing("b"), standing("a")) == ["a", "b"]


def test_no_success_comes_after_any_steps() -> None:
    assert order(standing("none", 0.0, None), standing("some", 0.0, 8.0, hours=1)) == ["some", "none"]


@pytest.mark.parametrize("rate", [None, nan, inf, -inf])
def test_incomplete_is_not_ranked(rate: float | None) -> None:
    assert order(standing("incomplete", rate), standing("complete", 0.0, None)) == ["complete"]


@given(standings, st.randoms())
def test_rank_does_not_depend_on_order(entries: list[Standing], shuffler: random.Random) -> None:
    shuffled = list(entries)
    shuffler.shuffle(shuffled)
    assert rank(shuffled) == rank(entries)


@given(standings)
def test_places_count_from_one_and_rates_never_rise(entries: list[Standing]) -> None:
    ranked = rank(entries)
    assert [entry.rank for entry in ranked] == list(range(1, len(ranked) + 1))
    rates = [nan if entry.standing.success_rate is None else entry.standing.success_rate for entry in ranked]
    assert all(isfinite(rate) for rate in rates)
    assert rates == sorted(rates, reverse=True)


@given(standings, standings)
def test_what_cannot_be_ranked_changes_nothing(entries: list[Standing], others: list[Standing]) -> None:
    broken = [replace(entry, success_rate=nan) for entry in others]
    assert rank([*broken, *entries]) == rank(entries)


@given(standings)
def test_missing_steps_never_outrank_finite_ones_of_the_same_rate(entries: list[Standing]) -> None:
    ranked = [entry.standing for entry in rank(entries)]
    for better, worse in pairwise(ranked):
        if better.success_rate == worse.success_rate and worse.mean_steps is not None and isfinite(worse.mean_steps):
            assert better.mean_steps is not None
            assert better.mean_steps <= worse.mean_steps


PEG, LOCK = "peg-insertion", "lock-opening"


def test_tasks_combine_by_the_mean() -> None:
    peg = score([make_record(1, env_steps=4), make_record(2, EpisodeOutcome.STEPS)])
    lock = score([make_record(1, env_steps=7)])
    combined = combine([PEG, LOCK], {PEG: peg, LOCK: lock})
    assert (combined.success_rate, combined.mean_steps) == (0.75, 5.5)
    assert combined.interval == interval_of_mean([peg, lock], of=2)


def test_combination_has_no_steps_where_a_task_has_none() -> None:
    scores = {PEG: score([make_record(1, EpisodeOutcome.STEPS)]), LOCK: score([make_record(1)])}
    combined = combine([PEG, LOCK], scores)
    assert (combined.success_rate, combined.mean_steps) == (0.5, None)


def test_a_task_that_is_not_played_counts_as_nothing() -> None:
    peg = score([make_record(1)])
    combined = combine([PEG, LOCK], {PEG: peg})
    assert (combined.success_rate, combined.mean_steps) == (0.5, None)
    assert (combined.interval.low, combined.interval.high) == pytest.approx((peg.interval.low / 2, 0.5))


def test_a_task_of_another_track_does_not_count() -> None:
    assert combine([PEG], {PEG: score([make_record(1)]), LOCK: score([make_record(1)])}).success_rate == 1.0


def test_equal_combined_rates_are_equal_numbers_so_that_steps_decide() -> None:
    def of(successes: int, episodes: int) -> Score:
        outcomes = [EpisodeOutcome.SUCCESS] * successes + [EpisodeOutcome.TACTILE] * (episodes - successes)
        return score([make_record(number, outcome) for number, outcome in enumerate(outcomes, start=1)])

    first = combine([PEG, LOCK], {PEG: of(96, 270), LOCK: of(128, 160)})
    second = combine([PEG, LOCK], {PEG: of(42, 270), LOCK: of(160, 160)})
    assert first.success_rate == second.success_rate
