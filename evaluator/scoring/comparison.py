"""Two evaluations of one episode list compared episode by episode; called by `vitac compare` and the pages."""

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Protocol

from vitac.envs.errors import VitacError


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
