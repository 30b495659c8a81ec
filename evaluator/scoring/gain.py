"""What sensing adds: the standard estimator against the blind run on the same episodes."""

from collections.abc import Iterable
from math import sqrt

from pydantic import Field, NonNegativeInt, PositiveInt
from vitac.envs.errors import VitacError

from ..strict_model import StrictModel
from .comparison import FinishedEpisode, mcnemar_p_value
from .score import NORMAL_QUANTILE


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
