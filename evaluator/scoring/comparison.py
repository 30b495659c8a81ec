"""Evaluations compared episode by episode: two of one list, a sensor and its blind run, and success against a draw."""

from collections.abc import Collection, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from math import sqrt
from operator import itemgetter
from typing import Protocol

from pydantic import Field, NonNegativeInt, PositiveInt
from vitac.envs.tasks.quantities import Quantity
from vitac.errors import VitacError

from ..strict_model import StrictModel
from .score import NORMAL_QUANTILE, Rate, rate_by_start
from .starts import PlayedEpisode, design_effect, find_start, group_by_start, permutation_p_value


class NothingToCompare(VitacError):
    """The two evaluations have no episode in common: they are of other tasks, parts of the list, or starts."""


class FinishedEpisode(PlayedEpisode, Protocol):
    """What a comparison reads of an episode; records have it, and so do the service's views of them."""

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
    def difference(self) -> int:
        """1 where only the first has solved it, -1 where only the second has, 0 otherwise."""
        return self.first.success - self.second.success


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Two evaluations of a task on the episodes that both have.

    Attributes:
        pairs: by number.
        unpaired: number of episodes that only one of them has, or that both began elsewhere.
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
    def by_start(self) -> list[list[int]]:
        """The differences of each start."""
        return group_by_start((find_start(pair.first), pair.difference) for pair in self.pairs)

    @property
    def difference(self) -> float:
        """Success rate of the first minus that of the second."""
        return (self.only_first - self.only_second) / len(self.pairs)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of that."""
        return paired_interval(self.by_start)

    @cached_property
    def p_value(self) -> float:
        """How likely a difference at least as large is if both were equally good."""
        return permutation_p_value(map(sum, self.by_start))


def compare_tasks(first: Iterable[FinishedEpisode], second: Iterable[FinishedEpisode]) -> dict[str, Comparison]:
    """Compare two evaluations in each task on the episodes that both have, in any order.

    At a station a start that is not blocked is replaced: such a trial is paired with one from the same place only.

    Raises:
        NothingToCompare: there is none.
    """
    ours, theirs = ({(end.task, end.episode): end for end in ends} for ends in (first, second))
    shared = sorted(ours.keys() & theirs.keys())
    common = [key for key in shared if find_start(ours[key]) == find_start(theirs[key])]
    if not common:
        message = (
            f"Expected two evaluations of one list, got {len(ours)} and {len(theirs)} episodes, none of them in both"
        )
        if shared:
            starts = " and ".join(_describe_start(side[shared[0]]) for side in (ours, theirs))
            message += f" from the same start: episode {shared[0][1]} starts with {starts}"
        raise NothingToCompare(f"{message}.")
    single = [task for task, _ in (ours.keys() | theirs.keys()) - set(common)]
    return {
        task: Comparison(
            pairs=tuple(EpisodePair(first=ours[key], second=theirs[key]) for key in keys), unpaired=single.count(task)
        )
        for task, keys in groupby(common, key=itemgetter(0))
    }


def _describe_start(end: FinishedEpisode) -> str:
    return f"{end.shape} at {', '.join(f'{value:g}' for value in end.initial_offset)}"


def adjust_p_values(p_values: Sequence[float]) -> list[float]:
    """Return the p-values of several tests, adjusted so that one in twenty families has any below 0.05 by chance.

    Of m tests the j-th smallest becomes the largest of (m - i + 1) p_i over i <= j, at most 1.
    S. Holm, A simple sequentially rejective multiple test procedure, Scandinavian Journal of Statistics 6 (1979) 65-70.
    """
    adjusted, largest = [0.0] * len(p_values), 0.0
    for rank, place in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[place]))
        adjusted[place] = largest
    return adjusted


class RunsDiffer(VitacError):
    """A standard and a blind run are not of the same episodes; play both on the same list."""


class SensingGain(StrictModel):
    """Standard minus blind success rate, with its 95 % interval and the exact p-value, both by start."""

    episodes: PositiveInt
    starts: PositiveInt
    standard_successes: NonNegativeInt
    blind_successes: NonNegativeInt
    gain: float = Field(ge=-1, le=1)
    low: float = Field(ge=-1, le=1)
    high: float = Field(ge=-1, le=1)
    p_value: float = Field(ge=0, le=1)


def sensing_gain(standard: Collection[FinishedEpisode], blind: Collection[FinishedEpisode]) -> SensingGain:
    """Return the gain over the episodes of both runs, which are of one task.

    Raises:
        RunsDiffer: they are not of the same episodes.
    """
    seeing, unseeing = ({end.episode: end for end in ends} for ends in (standard, blind))
    if not seeing or seeing.keys() != unseeing.keys():
        raise RunsDiffer(f"Expected both runs on the same episodes, got {len(seeing)} and {len(unseeing)}.")
    compared = Comparison(
        pairs=tuple(EpisodePair(first=seeing[number], second=unseeing[number]) for number in sorted(seeing)), unpaired=0
    )
    low, high = compared.interval
    return SensingGain(
        episodes=len(compared.pairs),
        starts=len(compared.by_start),
        standard_successes=compared.both + compared.only_first,
        blind_successes=compared.both + compared.only_second,
        gain=compared.difference,
        low=low,
        high=high,
        p_value=compared.p_value,
    )


def paired_interval(differences: Collection[Sequence[int]]) -> tuple[float, float]:
    """Return the 95 % interval of the difference of two paired rates.

    With half an episode added to each of the four kinds of pairs, b and c of n differ, and the interval is
    (b - c) / n +- z sqrt(b + c - (b - c)^2 / n) / n. The counts are those of as many independent pairs as the pairs
    tell as much as (`starts.design_effect`).
    A. Agresti and Y. Min, Simple improved confidence intervals for comparing matched proportions, Statistics in
    Medicine 24 (2005) 729-740, section 3.

    Args:
        differences: of each start, of each of its pairs: 1 if only the first succeeds, -1 if only the second.
    """
    effect, each = design_effect(differences), [value for group in differences for value in group]
    first, second, n = each.count(1) / effect + 0.5, each.count(-1) / effect + 0.5, len(each) / effect + 2.0
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
    quantity: Quantity, limits: tuple[float, float], episodes: Iterable[tuple[float, Hashable, bool]]
) -> tuple[RateOfPart, ...]:
    """Return the success rate of each part of a range, those without an episode left out.

    Where both sides of the nominal value are equally hard, the parts are of the distance from it.

    Args:
        quantity: that was drawn.
        limits: lowest and highest value that it can have.
        episodes: its value in each, the start, and whether it was solved.
    """
    if quantity.two_sided:
        episodes = [(abs(value - quantity.nominal), start, solved) for value, start, solved in episodes]
        limits = (0.0, max(abs(limit - quantity.nominal) for limit in limits))
    low, high = limits
    width = (high - low) / PARTS
    parts: list[list[tuple[Hashable, bool]]] = [[] for _ in range(PARTS)]
    for value, start, solved in episodes:
        parts[min(int((value - low) / width) if width else 0, PARTS - 1)].append((start, solved))
    return tuple(
        RateOfPart(low=low + part * width, high=low + (part + 1) * width, rate=rate_by_start(ends))
        for part, ends in enumerate(parts)
        if ends
    )
