"""The drift test on made-up teams: honest ones improve on all lists alike, who learns a list improves on it alone."""

import numpy as np
from vitac.evaluator.scoring.score import ALARM_BELOW, Rate, drift_p_value, wilson_interval

STARTS = 270


def rate(successes: int) -> Rate:
    return Rate(
        episodes=STARTS,
        starts=STARTS,
        successes=successes,
        success_rate=successes / STARTS,
        interval=wilson_interval(successes, STARTS),
    )


def play(random: np.random.Generator, hardness: np.ndarray, skill: float) -> Rate:
    """A run over starts of some hardness, each solved the more surely the more skilled the policy is."""
    return rate(int((random.random(STARTS) < 1 / (1 + np.exp(hardness - skill))).sum()))


def make_team(random: np.random.Generator, runs: int, learning: float) -> list[tuple[Rate, Rate]]:
    """The runs of a team that gets better by half a step each time, and learns the sealed list by some more."""
    sealed = random.normal(0.3, 1.5, STARTS)  # one list, a little harder than its law
    skill = random.normal(-1.0, 1.0)
    return [
        (
            play(random, sealed, skill + (0.5 + learning) * run),
            play(random, random.normal(0.0, 1.5, STARTS), skill + 0.5 * run),
        )
        for run in range(runs)
    ]


def test_of_forty_honest_teams_none_is_suspected_after_any_of_their_runs() -> None:
    random = np.random.default_rng(44)
    found = [drift_p_value(make_team(random, runs, 0.0)) for _ in range(40) for runs in (2, 3)]
    assert min(p for p in found if p is not None) > ALARM_BELOW


def test_a_team_that_learns_the_list_is_found() -> None:
    random = np.random.default_rng(44)
    assert all((drift_p_value(make_team(random, 3, 0.9)) or 1.0) < ALARM_BELOW for _ in range(10))
    reached = [rate(round(share * STARTS)) for share in np.linspace(0.25, 0.625, 13)]  # as an attack did in 13 runs
    assert (drift_p_value([(sealed, rate(round(0.25 * STARTS))) for sealed in reached]) or 1.0) < ALARM_BELOW


def test_a_single_run_says_nothing() -> None:
    assert drift_p_value([(rate(200), rate(100))]) is None
