"""Trials at stations: in which order they are played, which is played now, and what they have shown."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from datetime import timedelta
from itertools import combinations
from math import sqrt
from statistics import fmean
from typing import NamedTuple
from uuid import UUID

from sqlalchemy import Select, delete, func, select
from sqlalchemy.orm import Session
from vitac.evaluator.scoring.comparison import compare_tasks
from vitac.evaluator.scoring.score import NORMAL_QUANTILE, rate_by_start
from vitac.evaluator.scoring.starts import find_start
from vitac.evaluator.tracks.trial_plan import draw_plan

from ..accounts.shown_names import ShownNames
from ..audit import record
from ..competitions.competition import Competition, find_stage
from ..competitions.definition import TrialPlan
from ..competitions.stages import Stage
from ..database.clock import read_clock
from ..database.models import EpisodeResult, Evaluation, LivePicture, Station, Submission, Team, Trial
from ..database.states import OPEN_WORK_STATES, WorkState
from ..errors import ProblemCode, ServiceError, not_found
from ..evaluations.episode_store import EpisodeKey
from ..evaluations.history import newest_evaluation
from ..principals import Principal
from ..queue.work import UNPLANNED, at_station, find_station
from ..views.competition import PlannedTrialView, StationEffectView, TrialDifferenceView, TrialResultsView


def begin(session: Session, by: Principal, stage: Stage) -> int:
    """Make the plan of a stage that is over and let its trials begin; return how many there are.

    Trials that come later, as of a submission that is evaluated again, are planned behind by another call.

    Raises:
        ServiceError: not an organizer, the stage has no plan or is not over, the competition is final, a station is
            unknown, the control team has not one submission, or no trial waits.
    """
    by.require_organizer(stage.competition)
    Competition.lock(session, stage.competition).require_not_final()
    plan = _require_plan(stage)
    stage.require_over()
    _require_stations(session, plan)
    is_unplanned = Trial.state == WorkState.QUEUED, Trial.requires.endswith(UNPLANNED)
    waiting = session.scalars(_select(stage).where(*is_unplanned).with_for_update()).all()
    sealed = stage.sealed_list
    if not waiting or sealed is None:
        raise ServiceError(ProblemCode.INVALID_REQUEST, f"Expected trials of {stage} that wait for a plan, got none.")
    trials = {(str(trial.evaluation.submission_id), f"{trial.task} {trial.number}"): trial for trial in waiting}
    drawn = draw_plan(
        bytes.fromhex(sealed.secret),
        entries=sorted({entry for entry, _ in trials}),
        starts=sorted({start for _, start in trials}),
        stations=plan.stations,
        control=_find_control(session, stage, plan),
    )
    last = session.scalar(select(func.max(Trial.turn)).select_from(Trial)) or 0
    planned = [each for each in drawn if (each.entry, each.start) in trials]  # the control may have been played before
    for turn, each in enumerate(planned, start=last + 1):
        trial = trials[each.entry, each.start]
        trial.turn, trial.requires = turn, at_station(trial.requires, each.station)
    after = {"trials": len(planned), "stations": list(plan.stations)}
    record(session, by, "stage.plan_trials", stage.subject, after)
    return len(planned)


def list_trials(session: Session, by: Principal, stage: Stage) -> list[PlannedTrialView]:
    """Return the planned trials of a stage in their order: a team's own, and all for organizers and once published.

    Raises:
        ServiceError: the stage has no plan.
    """
    _require_plan(stage)
    sees_all = by.organizes(stage.competition) or stage.is_revealed
    names = ShownNames.read(session, by)
    shown = [
        (position, trial)
        for position, trial in enumerate(planned_trials(session, stage), start=1)
        if sees_all or trial.evaluation.submission.team_id == by.team_id
    ]
    now = read_twins(session)
    played = {each: _read_played_twins(session, each) for each in {trial.evaluation for _, trial in shown}}
    return [
        PlannedTrialView(
            position=position,
            station=(station := find_station(trial.requires)),
            twin=played[trial.evaluation].get((trial.task, trial.episodes[0]), now.get(station)),
            team=names.show_name(trial.evaluation.submission.team),
            submission_id=trial.evaluation.submission_id,
            submission_name=trial.evaluation.submission.name,
            task=trial.task,
            episode=trial.episodes[0],
            state=trial.state,
        )
        for position, trial in shown
    ]


def read_twins(session: Session) -> dict[str, str | None]:
    """Return what kind of twin each station is now, in words; None for hardware, and before its first agent."""
    return {station.name: station.twin for station in session.scalars(select(Station))}


def planned_trials(session: Session, stage: Stage) -> Sequence[Trial]:
    """Return all trials that have a place in the plan, in its order."""
    return session.scalars(_select(stage).where(~Trial.requires.endswith(UNPLANNED)).order_by(Trial.turn)).all()


def _select(stage: Stage) -> Select[Trial]:
    return select(Trial).join(Trial.evaluation).join(Evaluation.submission).where(stage.submissions)


def _read_played_twins(session: Session, evaluation: Evaluation) -> dict[tuple[str, int], str | None]:
    """Return on what kind of twin each trial of an evaluation was played, by task and number."""
    twin = EpisodeResult.record["evidence"]["twin"].astext
    key = EpisodeKey.from_evaluation(evaluation, evaluation.submission)
    rows = session.execute(select(EpisodeResult.task, EpisodeResult.episode, twin).where(*key.conditions()))
    return {(task, number): words for task, number, words in rows}


def _require_plan(stage: Stage) -> TrialPlan:
    if stage.rules.plan is None:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST, f"Expected a stage whose file gives it a plan of trials (`plan`), got {stage}."
        )
    return stage.rules.plan


def _require_stations(session: Session, plan: TrialPlan) -> None:
    known: Sequence[str] = session.scalars(select(Station.name)).all()
    unknown = [name for name in plan.stations if name not in known]
    if unknown:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"The plan names station {unknown[0]}, which is not known here: vitac admin station add {unknown[0]}.",
        )


def _find_control(session: Session, stage: Stage, plan: TrialPlan) -> str | None:
    if plan.control is None:
        return None
    of_control = select(Submission.id).join(Submission.team).where(stage.submissions, Team.name == plan.control)
    ids = session.scalars(of_control).all()
    if len(ids) != 1:
        raise ServiceError(
            ProblemCode.INVALID_REQUEST,
            f"Expected one submission of the control team {plan.control} to {stage}, got {len(ids)}.",
        )
    return str(ids[0])


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


_KEPT = timedelta(minutes=1)
"""Beyond the delay."""


def store_picture(session: Session, station: str, code: str, picture: bytes) -> bool:
    """Store what a station's cameras see in the trial with a code; whether anybody will see it."""
    trial = session.scalars(select(Trial).where(Trial.code == code)).first()
    if trial is None:
        return False
    stage = find_stage(session, trial.evaluation.submission)
    plan = stage.rules.plan
    if plan is None or plan.live_delay_s is None:
        return False
    oldest = read_clock(session) - timedelta(seconds=plan.live_delay_s) - _KEPT
    session.execute(delete(LivePicture).where(LivePicture.station == station, LivePicture.taken_at < oldest))
    session.add(LivePicture(station=station, picture=picture, **stage.place))
    return True


def find_picture(session: Session, competition: str, track: str, stage: str, station: str) -> LivePicture:
    """Return what everybody may see of a station now.

    Raises:
        ServiceError: there is no such stage, or nothing to see.
    """
    played = Competition.find(session, competition, track=track).stage(track, stage)
    delay_s = played.rules.plan.live_delay_s if played.rules.plan else None
    shown = None
    if delay_s is not None:
        latest = func.now() - timedelta(seconds=delay_s)
        window = (LivePicture.taken_at <= latest, LivePicture.taken_at > latest - _KEPT)
        query = select(LivePicture).where(LivePicture.station == station, *played.make_rows(LivePicture), *window)
        shown = session.scalars(query.order_by(LivePicture.taken_at.desc()).limit(1)).first()
    if shown is None:
        raise not_found("live picture", f"of station {station}")
    return shown
