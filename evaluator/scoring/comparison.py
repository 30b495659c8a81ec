"""Evaluations compared episode by episode: two of one list, a sensor and its blind run, and success against a draw."""

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import sqrt
from typing import Protocol

from pydantic import Field, NonNegativeInt, PositiveInt
from vitac.envs.errors import VitacError
from vitac.envs.tasks.quantities import Quantity

from ..strict_model import StrictModel
from .score import NORMAL_QUANTILE, Rate, rate


class NothingToCompare(VitacError):
    """The two evaluations have no episode in common: they are of other tasks, or of other parts of the list."""


class FinishedEpisode(Protocol):
    """What a comparison reads of an episode; records have it, and so do the service's views of them."""

    @property
    def task(self) -> str:
        """Its task."""

    @property
    def episode(self) -> int:
        """Its number in the list."""

    @property
    def shape(self) -> str:
        """Shape of the part."""

    @property
    def outcome(self) -> str:
        """How it ended."""

    @property
    def success(self) -> bool:
        """Whether the task was solved."""

    @property
    def env_steps(self) -> int:
        """How many env steps it took."""


@dataclass(frozen=True, kw_only=True)
class EpisodePair:
    """One episode of the list as both have played it."""

    first: FinishedEpisode
    second: FinishedEpisode

    @property
    def differs(self) -> bool:
        """Whether one has solved it and the other has not."""
        return self.first.success != self.second.success


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Two evaluations on the episodes that both have.

    Attributes:
        pairs: by task and number.
        unpaired: number of episodes that only one of them has.
    """

    pairs: tuple[EpisodePair, ...]
    unpaired: int

    @cached_property
    def both(self) -> int:
        """Number of episodes that both solve."""
        return sum(pair.first.success and pair.second.success for pair in self.pairs)

    @cached_property
    def only_first(self) -> int:
        """Number of episodes that only the first solves."""
        return sum(pair.first.success and not pair.second.success for pair in self.pairs)

    @cached_property
    def only_second(self) -> int:
        """Number of episodes that only the second solves."""
        return sum(pair.second.success and not pair.first.success for pair in self.pairs)

    @cached_property
    def neither(self) -> int:
        """Number of episodes that none of them solves."""
        return len(self.pairs) - self.both - self.only_first - self.only_second

    @cached_property
    def p_value(self) -> float:
        """How likely a difference at least as large is if both were equally good."""
        return mcnemar_p_value(self.only_first, self.only_second)


def compare(first: Iterable[FinishedEpisode], second: Iterable[FinishedEpisode]) -> Comparison:
    """Compare two evaluations on the episodes that both have, in any order.

    Raises:
        NothingToCompare: there is none.
    """
    ours, theirs = ({(end.task, end.episode): end for end in ends} for ends in (first, second))
    common = sorted(ours.keys() & theirs.keys())
    if not common:
        raise NothingToCompare(
            f"Expected two evaluations of one task, got {len(ours)} and {len(theirs)} episodes, none of them in both."
        )
    return Comparison(
        pairs=tuple(EpisodePair(first=ours[key], second=theirs[key]) for key in common),
        unpaired=len(ours.keys() ^ theirs.keys()),
    )


def mcnemar_p_value(only_first: int, only_second: int) -> float:
    """Return the exact two-sided p-value of McNemar's test.

    If both are equally good, each of the n = b + c episodes that only one of them solves is that of the first with
    probability 1/2, so p = min(1, 2 sum_{i <= min(b, c)} binom(n, i) / 2^n); 1 where n = 0.
    Q. McNemar, Note on the sampling error of the difference between correlated proportions or percentages,
    Psychometrika 12 (1947) 153-157, with the binomial distribution in place of its approximation.

    Args:
        only_first: episodes that only the first solves (b).
        only_second: episodes that only the second solves (c).
    """
    differing = only_first + only_second
    ways, tail = 1, 0
    for count in range(min(only_first, only_second) + 1):
        tail += ways
        ways = ways * (differing - count) // (count + 1)  # binom(n, i + 1); each from the factorials takes seconds
    return min(1.0, float(Fraction(2 * tail, 2**differing)))


class RunsDiffer(VitacError):
    """A standard and a blind run are not of the same episodes; play both on the same list."""


class SensingGain(StrictModel):
    """Standard minus blind success rate, with its 95 % interval and the exact McNemar p-value."""

    episodes: PositiveInt
    standard_successes: NonNegativeInt
    blind_successes: NonNegativeInt
    gain: float = Field(ge=-1, le=1)
    low: float = Field(ge=-1, le=1)
    high: float = Field(ge=-1, le=1)
    p_value: float = Field(ge=0, le=1)


def sensing_gain(standard: Iterable[FinishedEpisode], blind: Iterable[FinishedEpisode]) -> SensingGain:
    """Return the gain over the episodes of both runs.

    Raises:
        RunsDiffer: they are not of the same episodes.
    """
    seeing, unseeing = ({end.episode: end.success for end in ends} for ends in (standard, blind))
    if not seeing or seeing.keys() != unseeing.keys():
        raise RunsDiffer(f"Expected both runs on the same episodes, got {len(seeing)} and {len(unseeing)}.")
    only_standard = sum(success and not unseeing[number] for number, success in seeing.items())
    only_blind = sum(success and not seeing[number] for number, success in unseeing.items())
    low, high = paired_interval(only_standard, only_blind, len(seeing))
    return SensingGain(
        episodes=len(seeing),
        standard_successes=sum(seeing.values()),
        blind_successes=sum(unseeing.values()),
        gain=(only_standard - only_blind) / len(seeing),
        low=low,
        high=high,
        p_value=mcnemar_p_value(only_standard, only_blind),
    )


def paired_interval(only_first: int, only_second: int, pairs: int) -> tuple[float, float]:
    """Return the 95 % interval of the difference of two paired rates.

    With half an episode added to each of the four kinds of pairs, b and c of n differ, and the interval is
    (b - c) / n +- z sqrt(b + c - (b - c)^2 / n) / n.
    A. Agresti and Y. Min, Simple improved confidence intervals for comparing matched proportions, Statistics in
    Medicine 24 (2005) 729-740, section 3.

    Args:
        only_first: pairs in which only the first succeeds.
        only_second: pairs in which only the second succeeds.
        pairs: all of them.
    """
    first, second, n = only_first + 0.5, only_second + 0.5, pairs + 2.0
    centre = (first - second) / n
    half_width = NORMAL_QUANTILE * sqrt(first + second - (first - second) * (first - second) / n) / n
    return max(-1.0, centre - half_width), min(1.0, centre + half_width)


PARTS = 4
"""Number of equal parts that a range is cut into."""


class RateOfPart(StrictModel):
    """Successes of the episodes whose quantity was drawn between two values."""

    low: float
    high: float
    rate: Rate


def rates_by_draw(
    quantity: Quantity, limits: tuple[float, float], episodes: Iterable[tuple[float, bool]]
) -> tuple[RateOfPart, ...]:
    """Return the success rate of each part of a range, those without an episode left out.

    Where both sides of the nominal value are equally hard, the parts are of the distance from it.

    Args:
        quantity: that was drawn.
        limits: lowest and highest value that it can have.
        episodes: its value in each, and whether it was solved.
    """
    if quantity.two_sided:
        episodes = [(abs(value - quantity.nominal), solved) for value, solved in episodes]
        limits = (0.0, max(abs(limit - quantity.nominal) for limit in limits))
    low, high = limits
    width = (high - low) / PARTS
    solved: list[list[bool]] = [[] for _ in range(PARTS)]
    for value, success in episodes:
        solved[min(int((value - low) / width) if width else 0, PARTS - 1)].append(success)
    return tuple(
        RateOfPart(low=low + part * width, high=low + (part + 1) * width, rate=rate(sum(found), len(found)))
        for part, found in enumerate(solved)
        if found
    )
