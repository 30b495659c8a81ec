"""Whether a team learns a sealed list: its rate there rises faster than on fresh lists of the same law."""

from collections.abc import Sequence
from math import erfc, sqrt
from statistics import fmean

from .score import NORMAL_QUANTILE, CombinedScore, Rate, interval_of_difference

ALARM_BELOW = 0.001
"""p below which a drift is an alarm: of 40 honest teams none, of a thousand fewer than one."""


def drift_p_value(runs: Sequence[tuple[Rate | CombinedScore, Rate | CombinedScore]]) -> float | None:
    """Return how likely so steep a rise is if the sealed list is not learnt; None with fewer than two runs.

    One-sided test of the slope of d_i, the rate on the sealed list minus that on a fresh one, over the runs i = 1..n:
    z = sum (i - mean) d_i / sqrt(sum (i - mean)^2 v_i), with v_i from the 95 % interval of d_i. That a list is harder
    than others moves all d_i alike and leaves the slope. As all runs share the sealed starts, z is smaller than normal.

    Args:
        runs: of one team in the order of their submission, each with its rate on the sealed list and on a fresh one.
    """
    if len(runs) < 2:
        return None
    middle = fmean(range(len(runs)))
    slope = variance = 0.0
    for number, (sealed, fresh) in enumerate(runs):
        low, high = interval_of_difference(sealed, fresh)
        weight, deviation = number - middle, (high - low) / (2 * NORMAL_QUANTILE)
        slope += weight * (sealed.success_rate - fresh.success_rate)
        variance += (weight * deviation) ** 2
    return erfc(slope / sqrt(2 * variance)) / 2
