import random
from dataclasses import replace

import numpy as np
import pytest
from evaluation_records import make_record
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from vitac.envs.tasks.definition import Better, Measure
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.scoring.score import (
    Interval,
    Rate,
    Score,
    combine,
    compute_student_quantile,
    interval_of_difference,
    interval_of_mean,
    interval_of_seeds,
    rate,
    score,
    wilson_interval,
)


@given(st.integers(1, 1000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_interval_is_wilsons(counts: tuple[int, int]) -> None:
    from scipy.stats import binomtest

    successes, episodes = counts
    interval = wilson_interval(successes, episodes)
    oracle = binomtest(successes, episodes).proportion_ci(0.95, method="wilson")
    assert (interval.low, interval.high) == pytest.approx((oracle.low, oracle.high), abs=1e-12)
    assert 0 <= interval.low <= successes / episodes <= interval.high <= 1


def test_interval_of_the_organizers_result() -> None:
    interval = wilson_interval(40, 270)
    assert (round(interval.low, 3), round(interval.high, 3)) == (0.111, 0.195)


def test_interval_reaches_exactly_to_0_without_a_success_and_to_1_without_a_failure() -> None:
    for episodes in range(1, 301):
        none, all_of_them = wilson_interval(0, episodes), wilson_interval(episodes, episodes)
        assert (none.low, all_of_them.high) == (0.0, 1.0), episodes
        assert none.high == pytest.approx(1 - all_of_them.low)


@pytest.mark.parametrize(("first", "second"), [(0.5, 0.5), (0.15, 0.6), (0.9, 0.05), (0.98, 0.97)])
def test_interval_of_a_mean_covers_it_as_often_as_it_says(first: float, second: float) -> None:
    from scipy.stats import binom

    rates = [[rate(successes, episodes) for successes in range(episodes + 1)] for episodes in (90, 60)]
    chances = [np.atleast_1d(binom.pmf(range(91), 90, first)), np.atleast_1d(binom.pmf(range(61), 60, second))]
    covered = 0.0
    for one, chance in zip(rates[0], chances[0], strict=True):
        for other, chance_of_other in zip(rates[1], chances[1], strict=True):
            interval = interval_of_mean([one, other], of=2)
            covered += chance * chance_of_other * (interval.low <= (first + second) / 2 <= interval.high)
    assert 0.93 < covered < 0.97  # as Wilson's own: counts are whole, so it cannot be met everywhere


@pytest.mark.parametrize(("low", "high"), [(-0.1, 0.5), (0.5, 1.1), (1.1, 0.5), (0.5, -0.1)])
def test_bounds_outside_0_and_1_are_refused(low: float, high: float) -> None:
    with pytest.raises(ValidationError):
        Interval(low=low, high=high)


def test_interval_of_a_mean_of_one_is_its_own() -> None:
    mean, own = interval_of_mean([rate(3, 10)], of=1), wilson_interval(3, 10)
    assert (mean.low, mean.high) == pytest.approx((own.low, own.high))


@pytest.mark.parametrize(("rates", "half_width"), [((0.60, 0.70, 0.80), 4.3027 * 0.1 / 3**0.5), ((0.7, 0.7), None)])
def test_seeds_of_a_training_are_what_an_interval_over_them_counts(
    rates: tuple[float, ...], half_width: float | None
) -> None:
    seeds = [rate(round(1000 * each), 1000) for each in rates]
    interval, of_starts = interval_of_seeds(seeds), interval_of_mean(seeds, of=len(seeds))
    if half_width is None:
        assert interval == of_starts  # equal by chance: starts still vary
    else:
        assert (interval.low, interval.high) == pytest.approx((0.7 - half_width, 0.7 + half_width), abs=1e-4)
    assert interval_of_seeds(seeds[:1]) == interval_of_mean(seeds[:1], of=1)


@pytest.mark.parametrize("freedom", [1, 2, 3, 10, 100])
def test_quantile_is_students(freedom: int) -> None:
    from scipy.special import stdtrit

    assert compute_student_quantile(freedom) == pytest.approx(stdtrit(freedom, 0.975), rel=1e-8)


def test_interval_of_a_difference_is_that_of_newcombe() -> None:
    # R. G. Newcombe, Statistics in Medicine 17 (1998) 873-890, table II, contrast a, method 10: 56/70 and 48/80.
    assert interval_of_difference(rate(56, 70), rate(48, 80)) == pytest.approx((0.0524, 0.3339), abs=5e-5)


def test_score_counts_successes_and_averages_only_their_steps() -> None:
    records = [
        make_record(1, env_steps=3),
        make_record(2, env_steps=6),
        make_record(3, EpisodeOutcome.TACTILE, env_steps=1),
        make_record(4, EpisodeOutcome.POLICY_FAILED, env_steps=0),
    ]
    result = score(records)
    assert (result.episodes, result.successes, result.success_rate, result.mean_steps) == (4, 2, 0.5, 4.5)
    assert result.interval == wilson_interval(2, 4)
    assert result.outcomes == {"success": 2, "tactile": 1, "policy_failed": 1}
    assert {shape: (rate.successes, rate.episodes) for shape, rate in result.by_shape.items()} == {
        "cuboid": (1, 2),
        "trapezoid": (1, 1),
        "concave1": (0, 1),
    }


def test_without_success_there_is_no_mean() -> None:
    result = score([make_record(1, EpisodeOutcome.STEPS, env_steps=8)])
    assert (result.success_rate, result.mean_steps) == (0.0, None)


@given(st.lists(st.tuples(st.sampled_from(list(EpisodeOutcome)), st.integers(1, 8)), min_size=1), st.randoms())
def test_score_does_not_depend_on_order(ends: list[tuple[EpisodeOutcome, int]], shuffler: random.Random) -> None:
    records = [make_record(number, outcome, steps) for number, (outcome, steps) in enumerate(ends, start=1)]
    shuffled = list(records)
    shuffler.shuffle(shuffled)
    assert score(shuffled) == score(records)


@pytest.mark.parametrize("success_rate", [-0.01, 1.01, float("nan")])
def test_a_rate_outside_0_and_1_is_refused(success_rate: float) -> None:
    with pytest.raises(ValidationError):
        Rate(episodes=2, starts=2, successes=1, success_rate=success_rate, interval=Interval(low=0, high=1))


@pytest.mark.parametrize("success_rate", [0.0, 1.0])
def test_a_rate_may_be_0_and_1(success_rate: float) -> None:
    held = Rate(episodes=2, starts=2, successes=1, success_rate=success_rate, interval=Interval(low=0, high=1))
    assert held.success_rate == success_rate


@given(st.lists(st.sampled_from(EpisodeOutcome), min_size=1, max_size=12))
def test_shapes_and_outcomes_are_listed_in_one_order_whatever_the_records_order(outcomes: list[EpisodeOutcome]) -> None:
    records = [make_record(number, outcome) for number, outcome in enumerate(outcomes, start=1)]
    scored = score(records[::-1])
    assert list(scored.by_shape) == sorted({record.shape for record in records})
    assert list(scored.outcomes) == sorted(set(outcomes))
    assert sum(scored.outcomes.values()) == scored.episodes == len(records)
    assert sum(part.episodes for part in scored.by_shape.values()) == len(records)
    assert sum(part.successes for part in scored.by_shape.values()) == scored.successes


@given(st.lists(st.tuples(st.integers(0, 40), st.integers(1, 40)), min_size=1, max_size=4), st.integers(0, 3))
def test_the_interval_of_a_mean_holds_the_mean_and_stays_within_0_and_1(
    counts: list[tuple[int, int]], missing: int
) -> None:
    rates = [rate(min(successes, episodes), episodes) for successes, episodes in counts]
    interval = interval_of_mean(rates, of=len(rates) + missing)
    mean = sum(each.success_rate for each in rates) / (len(rates) + missing)
    assert 0.0 <= interval.low <= mean + 1e-12
    assert mean - 1e-12 <= interval.high <= 1.0
    if missing:
        assert interval.high < 1.0


def test_what_a_board_may_rank_by_is_averaged_where_every_episode_has_it() -> None:
    def measure(name: str, better: Better | None = Better.LOW) -> Measure:
        return Measure(
            name=name, label=name, meaning=name, unit="mm", needs=(name,), read=lambda info: info[name], better=better
        )

    measures = [measure("error_mm"), measure("sometimes_mm"), measure("shown_mm", None)]
    everywhere = {"error_mm": [0.5, 2.0], "shown_mm": [1.0]}
    records = [
        make_record(1, env_steps=1, infos=({**everywhere, "sometimes_mm": [1.0]},)),
        make_record(2, env_steps=1, infos=({**everywhere, "error_mm": [1.0]},)),
    ]
    assert score(records, measures).measures == {"error_mm": 1.5}
    unplayed = make_record(3, EpisodeOutcome.POLICY_FAILED, env_steps=0)
    assert score([*records, unplayed], measures).measures == {}
    assert score(records).measures == {}
    said = [replace(measure("error_mm"), of_no_env_step=6.0)]
    assert score([*records, unplayed], said).measures == {"error_mm": 3.0}


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
