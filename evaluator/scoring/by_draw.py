"""Success against a quantity drawn for every episode, in equal parts of its range. Used by pages and benchmarks."""

from collections.abc import Iterable

from vitac.envs.tasks.quantities import Quantity

from ..strict_model import StrictModel
from .score import Rate, rate

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
