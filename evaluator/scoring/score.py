"""The score of an evaluation, a pure function of its records; used by the CLI, the leaderboards and the pages."""

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from math import hypot, sqrt
from statistics import NormalDist, fmean

from pydantic import Field, NonNegativeInt, PositiveInt

from ..episodes.records import EpisodeOutcome, EpisodeRecord
from ..strict_model import StrictModel
from .forces import ForceSummary, summarize_forces

NORMAL_QUANTILE = NormalDist().inv_cdf(0.975)
"""For the two ends of a 95 % interval."""


class Interval(StrictModel):
    """A 95 % confidence interval of a rate."""

    low: float = Field(ge=0, le=1)
    high: float = Field(ge=0, le=1)


class Rate(StrictModel):
    """Successes among episodes."""

    episodes: PositiveInt
    successes: NonNegativeInt
    success_rate: float = Field(ge=0, le=1)
    interval: Interval


class Score(Rate):
    """The score of finished episodes. `mean_steps` is None without a success, `forces` without a record of any."""

    mean_steps: float | None
    by_shape: dict[str, Rate]
    outcomes: dict[EpisodeOutcome, NonNegativeInt]
    forces: ForceSummary | None = None


def wilson_interval(successes: int, episodes: int) -> Interval:
    """Return Wilson's score interval of a binomial rate: inside [0, 1] and never empty, unlike p +- z s.

    With p = successes / n and z the normal quantile:
    (p + z^2 / 2n +- z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n).
    E. B. Wilson, Probable inference, the law of succession, and statistical inference, JASA 22 (1927) 209-212.
    """
    z = NORMAL_QUANTILE
    rate, spread = successes / episodes, z * z / episodes
    centre = rate + spread / 2
    half_width = z * sqrt(rate * (1 - rate) / episodes + spread / (4 * episodes))
    low, high = (centre - half_width) / (1 + spread), (centre + half_width) / (1 + spread)
    # Rounding may leave the exact bounds 0 (no success) and 1 (no failure) by one unit in the last place.
    return Interval(low=0.0 if successes == 0 else low, high=1.0 if successes == episodes else high)


def interval_of_mean(rates: Sequence[Rate], *, of: int) -> Interval:
    """Return the interval of the mean of `of` rates of independent episodes, those not given being 0 by rule.

    With rates p_i and their intervals [l_i, u_i], from the variances recovered out of the single intervals:
    mean p - sqrt(sum (p_i - l_i)^2) / n to mean p + sqrt(sum (u_i - p_i)^2) / n. It lies within [0, 1] as they do.
    G. Y. Zou and A. Donner, Construction of confidence limits about effect measures: a general approach,
    Statistics in Medicine 27 (2008) 1693-1702, section 2.
    """
    mean = sum(rate.success_rate for rate in rates) / of
    below = hypot(*(rate.success_rate - rate.interval.low for rate in rates)) / of
    above = hypot(*(rate.interval.high - rate.success_rate for rate in rates)) / of
    return Interval(low=max(0.0, mean - below), high=min(1.0, mean + above))


def rate(successes: int, episodes: int) -> Rate:
    """Return the successes among episodes, with their interval."""
    return Rate(
        episodes=episodes,
        successes=successes,
        success_rate=successes / episodes,
        interval=wilson_interval(successes, episodes),
    )


def score(records: Collection[EpisodeRecord]) -> Score:
    """Return the success rate, interval and mean env steps of the successes over at least one record, in any order."""
    steps = sorted(record.env_steps for record in records if record.success)
    shapes = sorted({record.shape for record in records})
    return Score(
        **dict(rate(len(steps), len(records))),
        mean_steps=fmean(steps) if steps else None,
        by_shape={shape: _compute_rate(record for record in records if record.shape == shape) for shape in shapes},
        outcomes=dict(sorted(Counter(record.outcome for record in records).items())),
        forces=summarize_forces(record.forces for record in records),
    )


def _compute_rate(records: Iterable[EpisodeRecord]) -> Rate:
    solved = [record.success for record in records]
    return rate(sum(solved), len(solved))
