"""Scores: of a task and a track from its records, on parts of a list, and by kinds of failure."""

from collections import Counter
from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from math import comb, cos, erfc, hypot, isfinite, pi, sqrt, tan
from statistics import NormalDist, fmean, median, stdev

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from vitac.envs.tasks.definition import InfoView, Measure

from ..agent.verdicts import VerdictCode
from ..episodes.records import ContactForces, EpisodeOutcome, EpisodeRecord, FailureStage, ForceFigures, PolicyFailure
from ..strict_model import StrictModel
from ..tracks.definition import EpisodeList, ShardEpisodes
from .starts import Ways, convolve, design_effect, find_start, group_by_start


class ForceSummary(StrictModel):
    """Medians over the episodes whose records have forces, of the gel by its more loaded side in each episode.

    `over_force_events` is the sum over all of them, `over_force_episodes` the number of those that have any.
    """

    episodes: PositiveInt
    part: ForceFigures
    gel: ForceFigures | None = None
    over_force_n: PositiveFloat
    over_force_events: NonNegativeInt
    over_force_episodes: NonNegativeInt
    largest_stretch: NonNegativeFloat | None = None
    high_stretch: NonNegativeFloat | None = None


def summarize_forces(forces: Iterable[ContactForces | None]) -> ForceSummary | None:
    """Return the forces of an evaluation, those of gels where all are recorded; None where no record has any."""
    measured = [each for each in forces if each is not None]
    if not measured:
        return None
    events = [each.over_force_events for each in measured]
    gels = [each.gels for each in measured if each.gels is not None]
    return ForceSummary(
        episodes=len(measured),
        part=_medians([[each.part] for each in measured]),
        gel=_medians(gels) if len(gels) == len(measured) else None,
        over_force_n=measured[0].over_force_n,
        over_force_events=sum(events),
        over_force_episodes=sum(map(bool, events)),
        largest_stretch=_median(each.largest_stretch for each in measured),
        high_stretch=_median(each.high_stretch for each in measured),
    )


def _median(values: Iterable[float | None]) -> float | None:
    known = list(values)
    return None if None in known else median(value for value in known if value is not None)


def _medians(figures: Sequence[Sequence[ForceFigures]]) -> ForceFigures:
    """Return the median over episodes of each figure, of the largest where an episode has several."""
    return ForceFigures(
        **{
            name: median(max(getattr(each, name) for each in of_episode) for of_episode in figures)
            for name in ForceFigures.model_fields
        }
    )


NORMAL_QUANTILE = NormalDist().inv_cdf(0.975)
"""For the two ends of a 95 % interval."""


class Interval(StrictModel):
    """A 95 % confidence interval of a rate."""

    low: float = Field(ge=0, le=1)
    high: float = Field(ge=0, le=1)


class Rate(StrictModel):
    """Successes among episodes, with as many different starts; the interval counts starts, not their repeats."""

    episodes: PositiveInt
    starts: PositiveInt
    successes: NonNegativeInt
    success_rate: float = Field(ge=0, le=1)
    interval: Interval


class Score(Rate):
    """The score of finished episodes. `mean_steps` is None without a success, `forces` without a record of any.

    `measures` has the means of what boards may rank by and every episode has; `twins` how many episodes a twin of each
    kind played in place of a station's devices.
    """

    mean_steps: float | None
    by_shape: dict[str, Rate]
    outcomes: dict[EpisodeOutcome, NonNegativeInt]
    forces: ForceSummary | None = None
    measures: dict[str, float] = Field(default={})
    twins: dict[str, NonNegativeInt] = Field(default={})


@dataclass(frozen=True, kw_only=True)
class CombinedScore:
    """What a submission reached in all tasks of a track together.

    `mean_steps` is None where a task has none; `measures` has those that every task has.
    """

    success_rate: float
    interval: Interval
    mean_steps: float | None
    measures: Mapping[str, float] = field(default_factory=dict)


def combine(tasks: Collection[str], scores: Mapping[str, Score]) -> CombinedScore:
    """Return the means over a track's tasks: of their success rates, their mean env steps, and what they measure.

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
        measures=average_shared([score.measures for score in played]) if len(played) == len(tasks) else {},
    )


def wilson_interval(successes: float, episodes: float) -> Interval:
    """Return Wilson's score interval of a binomial rate: inside [0, 1] and never empty, unlike p +- z s.

    With p = successes / n and z the normal quantile:
    (p + z^2 / 2n +- z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n).
    E. B. Wilson, Probable inference, the law of succession, and statistical inference, JASA 22 (1927) 209-212.
    """
    z = NORMAL_QUANTILE
    rate, spread = successes / episodes, z * z / episodes
    centre = rate + spread / 2
    half_width = z * sqrt(rate * (1 - rate) / episodes + spread / (4 * episodes))
    low, high = (centre - half_width) / (1 + spread), (centre + half_width) / (1 + spread)
    # Rounding may leave the exact bounds 0 (no success) and 1 (no failure) by one unit in the last place.
    return Interval(low=0.0 if successes == 0 else low, high=1.0 if successes == episodes else high)


def interval_of_mean(rates: Sequence[Rate], *, of: int) -> Interval:
    """Return the interval of the mean of `of` rates of independent episodes, those not given being 0 by rule.

    With rates p_i and their intervals [l_i, u_i], from the variances recovered out of the single intervals:
    mean p - sqrt(sum (p_i - l_i)^2) / n to mean p + sqrt(sum (u_i - p_i)^2) / n. It lies within [0, 1] as they do.
    G. Y. Zou and A. Donner, Construction of confidence limits about effect measures: a general approach,
    Statistics in Medicine 27 (2008) 1693-1702, section 2.
    """
    mean = sum(rate.success_rate for rate in rates) / of
    below = hypot(*(rate.success_rate - rate.interval.low for rate in rates)) / of
    above = hypot(*(rate.interval.high - rate.success_rate for rate in rates)) / of
    return Interval(low=max(0.0, mean - below), high=min(1.0, mean + above))


def interval_of_difference(first: Rate | CombinedScore, second: Rate | CombinedScore) -> tuple[float, float]:
    """Return the 95 % interval of a rate minus another one of other starts.

    With rates p, q and their intervals [l, u], [k, v]: p - q - sqrt((p - l)^2 + (v - q)^2) to
    p - q + sqrt((u - p)^2 + (q - k)^2). Zou and Donner as above, equation 3.
    """
    difference = first.success_rate - second.success_rate
    below = hypot(first.success_rate - first.interval.low, second.interval.high - second.success_rate)
    above = hypot(first.interval.high - first.success_rate, second.success_rate - second.interval.low)
    return difference - below, difference + above


def interval_of_seeds(rates: Sequence[Rate]) -> Interval:
    """Return the interval of the mean over the seeds of a training, each of which is one draw of what it can give.

    It is Student's with the spread between the seeds, and at least as wide as the starts alone make it.
    """
    of_starts = interval_of_mean(rates, of=len(rates))
    if len(rates) == 1:
        return of_starts
    each = [rate.success_rate for rate in rates]
    half_width = compute_student_quantile(len(each) - 1) * stdev(each) / sqrt(len(each))
    return Interval(
        low=max(0.0, min(of_starts.low, fmean(each) - half_width)),
        high=min(1.0, max(of_starts.high, fmean(each) + half_width)),
    )


@cache
def compute_student_quantile(freedom: int) -> float:
    """Return the quantile of Student's distribution for the two ends of a 95 % interval.

    With n degrees of freedom its density is proportional to (1 + t^2 / n)^(-(n + 1) / 2), the integral of which becomes
    that of cos^(n - 1) from 0 to arctan(t / sqrt(n)). Student, The probable error of a mean, Biometrika 6 (1908) 1-25.
    """
    parts = 2000  # of Simpson's rule

    def integrate(end: float) -> float:
        values = [cos(end * part / parts) ** (freedom - 1) for part in range(parts + 1)]
        return end / (3 * parts) * (values[0] + 4 * sum(values[1::2]) + 2 * sum(values[2:-1:2]) + values[-1])

    low, high, wanted = 0.0, pi / 2, 0.95 * integrate(pi / 2)
    while high - low > 1e-12:
        middle = (low + high) / 2
        low, high = (middle, high) if integrate(middle) < wanted else (low, middle)
    return sqrt(freedom) * tan(low)


def rate(successes: int, episodes: int) -> Rate:
    """Return the successes among episodes that all have starts of their own, with their interval."""
    return Rate(
        episodes=episodes,
        starts=episodes,
        successes=successes,
        success_rate=successes / episodes,
        interval=wilson_interval(successes, episodes),
    )


def rate_by_start(ends: Iterable[tuple[Hashable, bool]]) -> Rate:
    """Return the successes among episodes, with Wilson's interval of as many independent ones as they tell as much as.

    E. L. Korn and B. I. Graubard, Confidence intervals for proportions with small expected number of positive counts
    estimated from survey data, Survey Methodology 24 (1998) 193-201, section 2.

    Args:
        ends: start of each episode, and whether it was solved.
    """
    groups = group_by_start(ends)
    successes, episodes, effect = sum(map(sum, groups)), sum(map(len, groups)), design_effect(groups)
    return Rate(
        episodes=episodes,
        starts=len(groups),
        successes=successes,
        success_rate=successes / episodes,
        interval=wilson_interval(successes / effect, episodes / effect),
    )


def score(records: Collection[EpisodeRecord], measures: Iterable[Measure] = ()) -> Score:
    """Return the score of at least one record, in any order.

    Args:
        records: of one task.
        measures: of the task (`TaskDefinition.measures`).
    """
    measures, ordered = tuple(measures), sorted(records, key=lambda record: record.episode)
    steps = sorted(record.env_steps for record in records if record.success)
    shapes = sorted({record.shape for record in records})
    return Score(
        **dict(_compute_rate(records)),
        mean_steps=fmean(steps) if steps else None,
        by_shape={shape: _compute_rate(record for record in records if record.shape == shape) for shape in shapes},
        outcomes=dict(sorted(Counter(record.outcome for record in records).items())),
        forces=summarize_forces(record.forces for record in records),
        measures=average_shared(
            [read_measures(record.infos[-1] if record.infos else None, measures) for record in ordered]
        ),
        twins=Counter(record.evidence.twin for record in ordered if record.evidence and record.evidence.twin),
    )


def read_measures(end: InfoView | None, measures: Iterable[Measure]) -> dict[str, float]:
    """Return what an episode has of what boards may rank by, from the info of its last env step; None without one."""
    values = {measure.name: measure.read_end(end) for measure in measures if measure.better is not None}
    return {name: value for name, value in values.items() if value is not None and isfinite(value)}


def average_shared(measured: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the means of what all of them have."""
    shared = [name for name in (measured[0] if measured else ()) if all(name in each for each in measured)]
    return {name: fmean(each[name] for each in measured) for name in shared}


def _compute_rate(records: Iterable[EpisodeRecord]) -> Rate:
    return rate_by_start((find_start(record), record.success) for record in records)


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


FAILURES_THAT_END_A_SHARD = 3
"""Number of policy failures in one shard that end the evaluation as failed: the policy is broken, not unlucky."""


def is_broken(failures: Collection[PolicyFailure]) -> bool:
    """Return whether a policy with these failures in one shard is given up."""
    return any(map(_ends_at_once, failures)) or len(failures) >= FAILURES_THAT_END_A_SHARD


def breaking_failure(shards: Sequence[ShardEpisodes], records: Iterable[EpisodeRecord]) -> PolicyFailure | None:
    """Return the failure that ends an evaluation as failed, or None while the policy works well enough to be scored.

    That is the first failure of the first shard that is broken, or there the one that ended it at once: a function of
    the records and the fixed cut only, so the same for any number of workers and for a resumed evaluation.
    """
    failures = {record.episode: record.failure for record in records if record.failure}
    for shard in sorted(shards, key=lambda shard: shard.index):
        in_shard = [failures[number] for number in sorted(shard.numbers & failures.keys())]
        if is_broken(in_shard):
            return next(filter(_ends_at_once, in_shard), in_shard[0])
    return None


def _ends_at_once(failure: PolicyFailure) -> bool:
    """Return whether no other episode of the shard could be played after this failure."""
    return failure.stage is FailureStage.LOAD or failure.code is VerdictCode.SHARD_TIME


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
