"""Which ranks the entries of a board could have by chance; called where boards are made."""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence


def rank_ranges(intervals: Sequence[tuple[float, float]]) -> list[tuple[int, int]]:
    """Return the first and last rank that each entry could have, given the 95 % intervals of all success rates.

    Ahead for certain is only who is above the whole interval, behind for certain who is below it. Entries of equal rank
    ranges cannot be distinguished by this number of episodes.

    Args:
        intervals: low and high end of each entry.
    """
    lows, highs = sorted(low for low, _ in intervals), sorted(high for _, high in intervals)
    n = len(intervals)
    return [(1 + n - bisect_right(lows, high), n - bisect_left(highs, low)) for low, high in intervals]
