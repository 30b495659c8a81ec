"""The gap between simulation and a station: how the same policies do on the same starts in both."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt, PositiveInt
from vitac.errors import VitacError

from ..strict_model import StrictModel
from .comparison import paired_interval
from .starts import group_by_start

ASKED_POLICIES: Final = 10
"""From so many on correlation and rank violation say something."""
_RESAMPLES: Final = 2000
_SEED: Final = 0
_OUTER: Final = (2.5, 97.5)
_MOST: Final = 95.0


class NoGap(VitacError):
    """Simulation and station have nothing in common that can be compared."""


@dataclass(frozen=True, kw_only=True)
class PlayedTwice:
    """One policy in simulation and at a station.

    Attributes:
        name: its name.
        ends: of each episode that both have, by number, whether it was solved in simulation, and at the station.
    """

    name: str
    ends: Mapping[int, tuple[bool, bool]]


class Measured(StrictModel):
    """A figure with its 95 % interval by start."""

    value: float
    low: float
    high: float


class PolicyGap(StrictModel):
    """One policy: how often it succeeds in both, and in which trials simulation and station agree."""

    name: str
    episodes: PositiveInt
    simulation: float = Field(ge=0, le=1)
    station: float = Field(ge=0, le=1)
    difference: Measured
    """Success rate in simulation minus that at the station."""
    both: NonNegativeInt
    only_simulation: NonNegativeInt
    only_station: NonNegativeInt
    neither: NonNegativeInt


class ByChance(StrictModel):
    """What 95 % of comparisons of this size stay within where there is no gap.

    Each episode is then solved with the mean rate of its policy, drawn apart for simulation and station.
    """

    difference: float = Field(ge=0)
    mean_maximum_rank_violation: float | None = Field(ge=0)
    """None for one policy."""


class Gap(StrictModel):
    """All policies together."""

    policies: tuple[PolicyGap, ...]
    difference: Measured
    """Mean over policies of the success rate in simulation minus that at the station."""
    agreement: Measured
    """Part of the trials that end in simulation as at the station."""
    pearson: Measured | None
    """Correlation of the success rates; None where all policies have one rate in one of them."""
    mean_maximum_rank_violation: Measured | None
    """Of the ranking in simulation against that at the station; None for one policy."""
    by_chance: ByChance


def measure_gap(policies: Sequence[PlayedTwice], starts: Mapping[int, Hashable]) -> Gap:
    """Return the gap over policies.

    Args:
        policies: that were played in both.
        starts: of every episode; its repeats count as one in every interval.

    Raises:
        NoGap: there is no policy, or one has no episode that was played in both.
    """
    if not policies:
        raise NoGap("Expected a policy that was played in simulation and at a station, got none.")
    for policy in policies:
        if not policy.ends:
            raise NoGap(f"Expected episodes of {policy.name} that simulation and station have both played, got none.")
    tallies = _tally(policies, starts)
    several = len(policies) > 1
    return Gap(
        policies=tuple(_policy_gap(policy, starts) for policy in policies),
        difference=_measured(mean_difference, tallies),
        agreement=_measured(agreement, tallies),
        pearson=_measured(pearson, tallies) if several and not np.isnan(pearson(tallies.sum(axis=0))) else None,
        mean_maximum_rank_violation=_measured(mean_maximum_rank_violation, tallies) if several else None,
        by_chance=_by_chance(tallies.sum(axis=0)),
    )


def measure_share(
    whole: Sequence[PlayedTwice], without: Sequence[PlayedTwice], starts: Mapping[int, Hashable]
) -> Measured | None:
    """Return which share of the difference of success goes away with one difference of a station; None without any.

    Args:
        whole: policies in simulation and at the station.
        without: the same, where the station lacks the difference.
        starts: of every episode.
    """
    count, tallies = len(whole), _tally((*whole, *without), starts)

    def share(tally: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore", invalid="ignore"):
            left, all_ = mean_difference(tally[..., count:, :]), mean_difference(tally[..., :count, :])
            return np.asarray(np.where(all_ == 0.0, np.nan, 1.0 - np.abs(left) / np.abs(all_)))

    return None if np.isnan(share(tallies.sum(axis=0))) else _measured(share, tallies)


def _tally(policies: Sequence[PlayedTwice], starts: Mapping[int, Hashable]) -> "FloatArray":
    """Return tallies by start and policy, shape [s, p, 4]."""
    rows = {start: row for row, start in enumerate(dict.fromkeys(starts.values()))}
    tallies = np.zeros((len(rows), len(policies), 4))
    for column, policy in enumerate(policies):
        for episode, (simulated, tried) in policy.ends.items():
            tallies[rows[starts[episode]], column] += (1, simulated, tried, simulated == tried)
    return tallies


FloatArray = NDArray[np.float64]
"""A tally of policies, shape [..., p, 4], has of each the number of episodes, of those solved in simulation, of those
solved at the station, and of those that end alike."""


def rates(tally: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the success rates in simulation and at the station, shapes [..., p]."""
    return tally[..., 1] / tally[..., 0], tally[..., 2] / tally[..., 0]


def mean_difference(tally: FloatArray) -> FloatArray:
    """Return the mean over policies of the success rate in simulation minus that at the station."""
    simulation, station = rates(tally)
    return np.asarray((simulation - station).mean(axis=-1))


def agreement(tally: FloatArray) -> FloatArray:
    """Return the part of all trials that end the same in both."""
    return np.asarray(tally[..., 3].sum(axis=-1) / tally[..., 0].sum(axis=-1))


def pearson(tally: FloatArray) -> FloatArray:
    """Return Pearson's correlation of the rates; NaN where a side has one rate only."""
    x, y = (side - side.mean(axis=-1, keepdims=True) for side in rates(tally))
    with np.errstate(invalid="ignore"):
        return np.asarray((x * y).sum(axis=-1) / np.sqrt((x * x).sum(axis=-1) * (y * y).sum(axis=-1)))


def mean_maximum_rank_violation(tally: FloatArray) -> FloatArray:
    """Return the mean over policies of the largest difference at the station to one that simulation ranks otherwise.

    X. Li et al., Evaluating Real-World Robot Manipulation Policies in Simulation, CoRL 2024, equation 2.
    """
    simulation, station = ((side[..., :, None], side[..., None, :]) for side in rates(tally))
    violated = (simulation[0] < simulation[1]) != (station[0] < station[1])
    return np.asarray((np.abs(station[0] - station[1]) * violated).max(axis=-1).mean(axis=-1))


def _measured(statistic: Callable[[FloatArray], FloatArray], tallies: FloatArray) -> Measured:
    """Return a statistic of tallies by start, shape [s, p, 4], with its interval by a cluster bootstrap of the starts.

    Resamples in which a policy has no episode, or that have no value, drop out.
    """
    starts = len(tallies)
    drawn = np.random.default_rng(_SEED).integers(starts, size=(_RESAMPLES, starts))
    resamples = tallies[drawn].sum(axis=1)
    values = statistic(resamples[(resamples[..., 0] > 0).all(axis=-1)])
    low, high = np.nanpercentile(values, _OUTER).tolist()
    return Measured(value=float(statistic(tallies.sum(axis=0))), low=low, high=high)


def _by_chance(tally: FloatArray) -> ByChance:
    counts = tally[:, 0].astype(np.int64)
    random, shape = np.random.default_rng(_SEED), (_RESAMPLES, len(counts))
    solved = [random.binomial(counts, (tally[:, 1] + tally[:, 2]) / (2 * counts), shape) for _ in range(2)]
    drawn = np.stack([np.broadcast_to(counts, shape), *solved, np.zeros(shape)], axis=-1)
    violation = np.percentile(mean_maximum_rank_violation(drawn), _MOST) if len(counts) > 1 else None
    return ByChance(
        difference=float(np.percentile(np.abs(mean_difference(drawn)), _MOST)),
        mean_maximum_rank_violation=None if violation is None else float(violation),
    )


def _policy_gap(policy: PlayedTwice, starts: Mapping[int, Hashable]) -> PolicyGap:
    solved = list(policy.ends.values())
    simulation, station = (sum(side) / len(solved) for side in zip(*solved, strict=True))
    differences = ((starts[episode], simulated - tried) for episode, (simulated, tried) in policy.ends.items())
    low, high = paired_interval(group_by_start(differences))
    return PolicyGap(
        name=policy.name,
        episodes=len(solved),
        simulation=simulation,
        station=station,
        difference=Measured(value=simulation - station, low=low, high=high),
        both=solved.count((True, True)),
        only_simulation=solved.count((True, False)),
        only_station=solved.count((False, True)),
        neither=solved.count((False, False)),
    )
