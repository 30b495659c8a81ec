"""What a plan's trials show: submissions compared in complete blocks, and whether a station makes a difference."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from math import sqrt
from statistics import fmean
from typing import NamedTuple
from uuid import UUID

from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.evaluator.scoring.comparison import compare_tasks
from vitac.evaluator.scoring.score import NORMAL_QUANTILE, rate_by_start
from vitac.evaluator.scoring.starts import find_start

from ..accounts.shown_names import ShownNames
from ..competitions.stages import Stage
from ..database.models import EpisodeResult, Submission, Trial
from ..database.states import OPEN_WORK_STATES
from ..evaluations.episode_store import EpisodeKey
from ..evaluations.history import newest_evaluation
from ..principals import Principal
from ..queue.work import find_station
from ..views.competition import StationEffectView, TrialDifferenceView, TrialResultsView
from .trial_plan import planned_trials

Places = Mapping[tuple[UUID, str, int], Trial]
"""Planned trials by submission, task and start."""
Played = Mapping[tuple[str, int], EpisodeResult]
"""Stored episodes of a submission, by task and number."""


class Platform(NamedTuple):
    """What trials were played on: a station, or a twin in place of its devices."""

    name: str
    twin: str | None


def summarize(session: Session, by: Principal, stage: Stage) -> TrialResultsView | None:
    """Return the results of a stage's plan; None while a trial waits or runs, but for organizers, or without any."""
    trials = planned_trials(session, stage)
    is_over = bool(trials) and not any(trial.state in OPEN_WORK_STATES for trial in trials)
    if not (is_over or by.organizes(stage.competition)):
        return None
    places = {(trial.evaluation.submission_id, trial.task, trial.episodes[0]): trial for trial in trials}
    submissions = sorted(
        {trial.evaluation.submission for trial in trials}, key=lambda each: (each.submitted_at, each.id)
    )
    played = {each: _read_played(session, each, places) for each in submissions}
    common = _find_common(played.values())
    if not common:
        return None
    names = ShownNames.read(session, by)
    return TrialResultsView(
        blocks=len(common),
        trials_left_out=sum(len(each) - len(common) for each in played.values()),
        differences=_compare(played, common, {each: _name(names, each) for each in submissions}),
        stations=_find_effects(played, places),
    )


def _name(names: ShownNames, submission: Submission) -> str:
    return f"{names.show_name(submission.team)}: {submission.name}"


def _read_played(session: Session, submission: Submission, places: Places) -> Played:
    key = EpisodeKey.from_evaluation(newest_evaluation(session, submission), submission)
    rows = session.scalars(select(EpisodeResult).where(*key.conditions()))
    return {(row.task, row.episode): row for row in rows if (submission.id, row.task, row.episode) in places}


def _find_common(played: Iterable[Played]) -> set[tuple[str, int]]:
    """Return the blocks that all have played from the same start: one station may have replaced it."""
    starts = [{(key, find_start(row)) for key, row in each.items()} for each in played]
    return {key for key, _ in set.intersection(*starts)} if starts else set()


def _compare(
    played: Mapping[Submission, Played], common: set[tuple[str, int]], names: Mapping[Submission, str]
) -> list[TrialDifferenceView]:
    differences = []
    for first, second in combinations(played, 2):
        for comparison in compare_tasks(*([played[each][key] for key in common] for each in (first, second))).values():
            differences.append(TrialDifferenceView.from_row(comparison, first=names[first], second=names[second]))
    return differences


def _find_effects(played: Mapping[Submission, Played], places: Places) -> list[StationEffectView]:
    by_station: dict[Platform, list[EpisodeResult]] = defaultdict(list)
    at: dict[tuple[Platform, Submission], list[bool]] = defaultdict(list)
    for submission, episodes in played.items():
        for (task, number), row in episodes.items():
            name = find_station(places[submission.id, task, number].requires)
            station = Platform(name, row.record["evidence"]["twin"])
            by_station[station].append(row)
            at[station, submission].append(row.success)
    return [
        _make_effect(station, by_station[station], _list_differences(station, by_station, at, played))
        for station in sorted(by_station, key=lambda each: (each.name, each.twin or ""))
    ]


def _list_differences(
    station: Platform,
    stations: Iterable[Platform],
    at: Mapping[tuple[Platform, Submission], Sequence[bool]],
    submissions: Iterable[Submission],
) -> list[tuple[float, float]]:
    """Return for each submission its rate at a station minus that elsewhere, with its variance."""
    differences = []
    for submission in submissions:
        here = at.get((station, submission), [])
        there = [end for other in stations if other != station for end in at.get((other, submission), [])]
        if here and there:
            differences.append((fmean(here) - fmean(there), _variance(here) + _variance(there)))
    return differences


def _variance(ends: Sequence[bool]) -> float:
    """Return the variance of a rate, with one success and one failure added so that few trials do not make it 0.

    A. Agresti and B. Caffo, Simple and effective confidence intervals for proportions and differences of proportions,
    The American Statistician 54 (2000) 280-288.
    """
    rate = (sum(ends) + 1) / (len(ends) + 2)
    return rate * (1 - rate) / (len(ends) + 2)


def _make_effect(
    station: Platform, rows: Sequence[EpisodeResult], differences: Sequence[tuple[float, float]]
) -> StationEffectView:
    rate = rate_by_start((find_start(row), row.success) for row in rows)
    effect, interval = None, None
    if differences:
        effect = fmean(difference for difference, _ in differences)
        half = NORMAL_QUANTILE * sqrt(sum(variance for _, variance in differences)) / len(differences)
        interval = (max(effect - half, -1.0), min(effect + half, 1.0))
    return StationEffectView.from_row(
        rate,
        station=station.name,
        twin=station.twin,
        success_rate_interval=(rate.interval.low, rate.interval.high),
        effect=effect,
        effect_interval=interval,
    )
