"""The plan of a stage that stations play: made once the stage has closed, from the secret of its sealed list.

Until then its trials wait for no worker. Then each waits for the station and the turn that the plan gives it.
"""

from collections.abc import Sequence

from sqlalchemy import Select, func, select
from sqlalchemy.orm import Session
from vitac.evaluator.tracks.trial_plan import draw_plan

from ..accounts.shown_names import ShownNames
from ..audit import record
from ..competitions.competition import Competition
from ..competitions.definition import TrialPlan
from ..competitions.stages import Stage
from ..database.models import EpisodeResult, Evaluation, Station, Submission, Team, Trial
from ..database.states import WorkState
from ..errors import ProblemCode, ServiceError
from ..evaluations.episode_store import EpisodeKey
from ..principals import Principal
from ..queue.work import UNPLANNED, at_station, find_station
from ..views.competition import PlannedTrialView


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
