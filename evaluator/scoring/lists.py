"""Whether a policy is better on the list that everybody knows than on a sealed one; called where evaluations end."""

from collections import Counter
from collections.abc import Collection, Iterator
from fractions import Fraction
from math import comb

from ..episodes.records import EpisodeRecord
from ..tracks.definition import EpisodeList
from .starts import Ways, convolve


def better_on_public_p_value(
    starts: EpisodeList, public: Collection[EpisodeRecord], sealed: Collection[EpisodeRecord]
) -> float:
    """Return how likely a difference at least as large in favour of the public list is if both are equally hard.

    Exact and one-sided: of all ways in which the starts of both lists could have been divided between them, for each
    shape as many as there are, the share in which the public one has as many successes or more. A start is what is
    divided, with all its repeats, because these are no independent episodes. With one repeat and one shape it is
    Fisher's exact test (R. A. Fisher, The logic of inductive inference, J. R. Stat. Soc. 98 (1935) 39-82); with
    repeats and shapes the permutation test of E. J. G. Pitman, Significance tests which may be applied to samples from
    any populations, Suppl. J. R. Stat. Soc. 4 (1937) 119-130, within strata.

    Args:
        starts: of either list; both repeat their starts alike.
        public: all records on the public list.
        sealed: all records on the sealed list.
    """
    ours, theirs = (_successes(starts, records) for records in (public, sealed))
    observed = sum(successes for of_shape in ours.values() for successes in of_shape)
    ways: Ways = {0: 1}
    for shape, of_shape in ours.items():
        ways = convolve(ways, _choose([*of_shape, *theirs[shape]], len(of_shape)))
    as_large = sum(count for total, count in ways.items() if total >= observed)
    return float(Fraction(as_large, sum(ways.values())))


def _successes(starts: EpisodeList, records: Collection[EpisodeRecord]) -> dict[str, list[int]]:
    """Return the number of successes of each start, by shape."""
    solved = {record.episode: record.success for record in records}
    shapes = [start.shape for block in starts.blocks for start in block.starts]
    counts = Counter(start for number, start in enumerate(_start_of_each_episode(starts), start=1) if solved[number])
    by_shape: dict[str, list[int]] = {}
    for start, shape in enumerate(shapes):
        by_shape.setdefault(shape, []).append(counts[start])
    return by_shape


def _start_of_each_episode(starts: EpisodeList) -> Iterator[int]:
    first = 0
    for block in starts.blocks:
        for _ in range(block.repeats):
            yield from range(first, first + len(block.starts))
        first += len(block.starts)


def _choose(successes: list[int], chosen: int) -> Ways:
    """Return the ways to choose some of the starts, by the successes of those that are chosen."""
    ways = {(0, 0): 1}
    for value, there in Counter(successes).items():
        grown: Counter[tuple[int, int]] = Counter()
        for (count, total), n in ways.items():
            for more in range(min(there, chosen - count) + 1):
                grown[count + more, total + more * value] += n * comb(there, more)
        ways = dict(grown)
    return {total: n for (count, total), n in ways.items() if count == chosen}
