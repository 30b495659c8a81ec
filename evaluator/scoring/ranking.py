"""The order of a leaderboard, a pure function of standings; called by the server."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from math import inf, isfinite
from statistics import fmean

from .score import Interval, Score, interval_of_mean


@dataclass(frozen=True, kw_only=True)
class Standing:
    """What decides the place of one complete evaluation.

    `success_rate` and `mean_steps` may be missing or not finite for an evaluation that is not complete.
    """

    id: str
    success_rate: float | None
    mean_steps: float | None
    submitted_at: datetime


@dataclass(frozen=True, kw_only=True)
class Ranked:
    """A standing with its place, from 1."""

    rank: int
    standing: Standing


def rank(standings: Iterable[Standing]) -> list[Ranked]:
    """Return the places by success rate (high first), mean env steps (few first), submission time (early first), id.

    A standing without a finite success rate is left out. One without a finite mean of steps (no success) comes after
    all others of its success rate. The input's order has no influence.
    """
    rankable = sorted((standing for standing in standings if _is_rankable(standing)), key=_key)
    return [Ranked(rank=place, standing=standing) for place, standing in enumerate(rankable, start=1)]


@dataclass(frozen=True, kw_only=True)
class CombinedScore:
    """What a submission reached in all tasks of a track together. `mean_steps` is None where a task has none."""

    success_rate: float
    interval: Interval
    mean_steps: float | None


def combine(tasks: Collection[str], scores: Mapping[str, Score]) -> CombinedScore:
    """Return the combination of a track's tasks: the mean of their success rates, and the mean of their mean env steps.

    A task without a score counts as 0 successes and has no mean of steps.

    Args:
        tasks: all tasks of the track.
        scores: by task, of those that were played.
    """
    played = [scores[task] for task in tasks if task in scores]
    steps = [score.mean_steps for score in played if score.mean_steps is not None]
    # Exact until the last: rounded sums of equal rates may differ, and the steps would not be asked.
    rates = sum((Fraction(score.successes, score.episodes) for score in played), Fraction(0))
    return CombinedScore(
        success_rate=float(rates / len(tasks)),
        interval=interval_of_mean(played, of=len(tasks)),
        mean_steps=fmean(steps) if len(steps) == len(tasks) else None,
    )


def _is_rankable(standing: Standing) -> bool:
    return standing.success_rate is not None and isfinite(standing.success_rate)


def _key(standing: Standing) -> tuple[float, float, datetime, str]:
    steps = standing.mean_steps if standing.mean_steps is not None and isfinite(standing.mean_steps) else inf
    return (-(standing.success_rate or 0.0), steps, standing.submitted_at, standing.id)
