"""The order of a leaderboard, a pure function of standings; called by the server."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime
from math import inf, isfinite

from .scoring import Score


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
    """Places by success rate (high first), mean env steps (few first), submission time (early first), id.

    A standing without a finite success rate is left out. One without a finite mean of steps (no success) comes after
    all others of its success rate. The input's order has no influence.
    """
    rankable = sorted((standing for standing in standings if _is_rankable(standing)), key=_key)
    return [Ranked(rank=place, standing=standing) for place, standing in enumerate(rankable, start=1)]


def combine(scores: Sequence[Score]) -> tuple[float, float | None]:
    """Success rate and mean env steps of a track with several tasks.

    The mean of the tasks' success rates, and the mean of their mean steps; None if a task has no success.
    """
    steps = [score.mean_steps for score in scores if score.mean_steps is not None]
    mean_steps = sum(steps) / len(steps) if len(steps) == len(scores) else None
    return sum(score.success_rate for score in scores) / len(scores), mean_steps


def _is_rankable(standing: Standing) -> bool:
    return standing.success_rate is not None and isfinite(standing.success_rate)


def _key(standing: Standing) -> tuple[float, float, datetime, str]:
    steps = standing.mean_steps if standing.mean_steps is not None and isfinite(standing.mean_steps) else inf
    return (-(standing.success_rate or 0.0), steps, standing.submitted_at, standing.id)
