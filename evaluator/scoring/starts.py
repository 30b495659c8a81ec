"""What repeats of a start tell: the unit of every interval and test of a score is the start, not the episode.

Episodes with the same start often end alike, so that 270 of them may tell as little as 140 independent ones.
"""

from collections import Counter
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Protocol, TypeVar

from ..tracks.definition import DRAWN

ValueT = TypeVar("ValueT", int, bool)
Ways = Mapping[int, int]
"""In how many ways each total comes about."""


class PlayedEpisode(Protocol):
    """What says which start an episode had."""

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
    def initial_offset(self) -> Sequence[float]:
        """Where it started, in the units of the task's `offset_option`."""


def find_start(episode: PlayedEpisode) -> Hashable:
    """Return what the repeats of a start have in common."""
    start = (episode.task, episode.shape, tuple(episode.initial_offset))
    return (*start, episode.episode) if episode.shape == DRAWN else start


def group_by_start(values: Iterable[tuple[Hashable, ValueT]]) -> list[list[ValueT]]:
    """Return the values of each start, given as pairs of start and value of an episode."""
    groups: dict[Hashable, list[ValueT]] = {}
    for start, value in values:
        groups.setdefault(start, []).append(value)
    return list(groups.values())


def intraclass_correlation(groups: Collection[Sequence[int]]) -> float:
    """Return how alike the episodes of a start end, between 0 (as those of different starts) and 1 (all alike).

    With mean squares B between and W within k starts, of m_i episodes and n in all, it is (B - W) / (B + (m - 1) W),
    where m = (n - sum m_i^2 / n) / (k - 1); a negative estimate counts as 0.
    A. Donner and J. J. Koval, The estimation of intraclass correlation in the analysis of family data, Biometrics 36
    (1980) 19-25, section 2. Where all episodes end alike nothing can be estimated, and it is taken for 1: each start
    counts once.

    Args:
        groups: of each start the value of each of its episodes.
    """
    sizes = [len(group) for group in groups]
    k, n = len(sizes), sum(sizes)
    if k == n:
        return 0.0
    mean = sum(map(sum, groups)) / n
    between = sum(len(group) * (sum(group) / len(group) - mean) ** 2 for group in groups)
    within = sum((value - sum(group) / len(group)) ** 2 for group in groups for value in group) / (n - k)
    if k == 1 or between + within == 0:
        return 1.0
    between /= k - 1
    size = (n - sum(size * size for size in sizes) / n) / (k - 1)
    return max(0.0, (between - within) / (between + (size - 1) * within))


def design_effect(groups: Collection[Sequence[int]]) -> float:
    """Return by how much the variance of a mean over episodes exceeds that of as many independent ones.

    With the intraclass correlation r it is 1 + (sum m_i^2 / n - 1) r: n episodes tell as much as n divided by it.
    L. Kish, Survey Sampling (1965), section 5.4, with the mean size of a cluster as an episode meets it.

    Args:
        groups: of each start the value of each of its episodes.
    """
    sizes = [len(group) for group in groups]
    return 1 + (sum(size * size for size in sizes) / sum(sizes) - 1) * intraclass_correlation(groups)


def permutation_p_value(differences: Iterable[int]) -> float:
    """Return the exact two-sided p-value of paired differences, one of each start.

    If both sides are equally good, either could have had the other's episodes of a start, so that each difference has
    either sign with probability 1/2; the p-value is the share of all 2^k signs whose sum is as far from 0 as the
    observed one. E. J. G. Pitman, Significance tests which may be applied to samples from any populations, Suppl. J. R.
    Stat. Soc. 4 (1937) 119-130. With one episode of each start it is the exact test of Q. McNemar, Note on the sampling
    error of the difference between correlated proportions or percentages, Psychometrika 12 (1947) 153-157.
    """
    chosen = [difference for difference in differences if difference]
    ways: Ways = {0: 1}
    for size, count in Counter(map(abs, chosen)).items():
        ways = convolve(ways, _choose_signs(size, count))
    observed = abs(sum(chosen))
    as_far = sum(count for total, count in ways.items() if abs(total) >= observed)
    return float(Fraction(as_far, 2 ** len(chosen)))


def _choose_signs(size: int, count: int) -> Ways:
    """Return the ways to give signs to equal numbers, by their sum."""
    ways, signs = {}, 1
    for negative in range(count + 1):
        ways[size * (count - 2 * negative)] = signs
        signs = signs * (count - negative) // (negative + 1)  # each from the factorials takes seconds
    return ways


def convolve(first: Ways, second: Ways) -> Ways:
    """Return the ways in which the sum of two totals comes about."""
    sums: Counter[int] = Counter()
    for one, ways in first.items():
        for other, more in second.items():
            sums[one + other] += ways * more
    return sums
