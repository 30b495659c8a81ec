"""Makes the view of a submission out of its rows; called by `listing` for the API and the pages."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from uuid import UUID

from sqlalchemy.orm import Session
from vitac.evaluator.logs.findings import LogFinding

from ..accounts.shown_names import ShownNames
from ..accounts.teams import team_view
from ..competitions.competition import find_stage
from ..competitions.stages import Stage
from ..database.models import Evaluation, Submission
from ..database.states import EvaluationState
from ..evaluations.copies import find_copies
from ..evaluations.logs import make_finding_views
from ..evaluations.scores import counted_tasks
from ..evaluations.view import EvaluationRows, evaluation_view, summary_view
from ..leaderboards.best_entries import Board, PlacesOfBoards, places
from ..leaderboards.descriptions import show_description
from ..leaderboards.standings import explain_unranked_submission
from ..principals import Principal
from ..queue.work import UNPLANNED
from ..queue.workers import Fleet, fleet
from ..settings import Settings
from ..tracks import find_family
from ..views.evaluations import CopyView
from ..views.operations import WorkersView
from ..views.submissions import RankView, SubmissionView
from .kinds import SERVED_KINDS

PlacesOf = Callable[[Stage], PlacesOfBoards]

WorkersOf = Callable[[str, str, tuple[str, ...], bool], WorkersView]
"""Finds workers by evaluator version, track and tasks."""


def submission_views(
    session: Session,
    settings: Settings,
    runs: Mapping[UUID, Sequence[Evaluation]],
    by: Principal,
    *,
    with_output: bool = False,
) -> list[SubmissionView]:
    """Return submissions with their newest evaluations; what they share is read once for all.

    Args:
        session: of the transaction.
        settings: of this process.
        runs: the evaluations of each submission, newest first (`histories`).
        by: who asks, and gets what may be shown to them.
        with_output: show also what the policies printed.
    """
    newest = [evaluation[0] for evaluation in runs.values()]
    rows = EvaluationRows.read(session, newest, by, with_output=with_output)
    names = ShownNames.read(session, by)
    known_workers = fleet(session, settings)
    shown = _Shown(
        evaluations=rows,
        by=by,
        names=names,
        findings=make_finding_views(session, [evaluation for evaluation in newest if evaluation.id not in rows.hidden]),
        copies=find_copies(
            session,
            [evaluation.id for evaluation in newest],
            names,
            logs=[evaluation.id for evaluation in newest if evaluation.submission.kind.form.is_verified],
        ),
        fleet=known_workers,
        workers=cache(partial(_workers, known_workers)),
        places=cache(partial(_places, session, by)),
        find_stage=cache(partial(find_stage, session)),
    )
    return [_view(evaluation, shown) for evaluation in runs.values()]


def _places(session: Session, by: Principal, stage: Stage) -> PlacesOfBoards:
    """Return all places as the boards show them, which may be frozen for all but organizers."""
    return places(session, Board.from_results(stage, stage.counted_results(live=by.organizes(stage.competition))))


@dataclass(frozen=True, kw_only=True)
class _Shown:
    """What submissions are shown with.

    Attributes:
        by: who asks.
        names: under which teams are shown to them.
        evaluations: of their newest evaluations.
        findings: against logs, by evaluation, where single episodes are shown.
        copies: by evaluation.
        fleet: the workers known now.
        workers: who of them can run some tasks.
        places: on the boards of a stage.
        find_stage: to which stage a submission was made.
    """

    by: Principal
    names: ShownNames
    evaluations: EvaluationRows
    findings: Mapping[UUID, LogFinding]
    copies: Mapping[UUID, CopyView]
    fleet: Fleet
    workers: WorkersOf
    places: PlacesOf
    find_stage: Callable[[Submission], Stage]


def _view(runs: Sequence[Evaluation], shown: _Shown) -> SubmissionView:
    newest, submission = runs[0], runs[0].submission
    log_view = SERVED_KINDS[submission.kind].log_view
    ranks = _ranks(newest, shown)
    log = log_view(submission, newest, shown.findings.get(newest.id)) if log_view else None
    if log is not None and shown.names.hides(submission.team):
        log = log.model_copy(update={"team_named": None})
    shown_runs = runs if shown.by.may_see(submission.team_id, submission.competition) else runs[:1]
    return SubmissionView.from_row(
        submission,
        team=team_view(submission.team, shown.names),
        competition=submission.competition or None,
        stage=submission.stage or None,
        missing_tasks=[task for task in counted_tasks(newest) if task not in submission.tasks],
        public=submission.is_public,
        chosen=_is_chosen(submission, shown),
        deleted_at=submission.erased_at,
        copy_of=shown.copies.get(newest.id),
        description=show_description(submission, shown.by, shown.names),
        evaluation=evaluation_view(newest, shown.fleet.alive, shown.evaluations),
        evaluations=[summary_view(evaluation) for evaluation in shown_runs],
        workers=shown.workers(
            newest.evaluator_version, submission.track, tuple(submission.tasks), submission.needs_gpu
        ),
        unranked=_explain_unranked(newest, shown),
        waits=_explain_wait(newest, shown),
        rank=ranks.get(None),
        task_ranks={task: place for task, place in ranks.items() if task is not None},
        log=log,
    )


def _is_chosen(submission: Submission, shown: _Shown) -> bool | None:
    may_see = shown.by.may_see(submission.team_id, submission.competition)
    is_model_of_live = submission.kind.form.runs_policy and shown.find_stage(submission).has_final
    return submission.chosen_at is not None if may_see and is_model_of_live else None


def _explain_unranked(newest: Evaluation, shown: _Shown) -> str | None:
    submission, copy = newest.submission, shown.copies.get(newest.id)
    if copy is not None and not copy.ranked:
        return copy.sentence
    if newest.state is not EvaluationState.COMPLETED or not submission.kind.form.runs_policy:
        return None
    counted = shown.find_stage(submission).counted_results()
    return explain_unranked_submission(newest.evaluator_version, counted, submission.track)


def _explain_wait(newest: Evaluation, shown: _Shown) -> str | None:
    if newest.state is not EvaluationState.QUEUED:
        return None
    rules = shown.find_stage(newest.submission).rules
    if rules.plan is None or not any(shard.requires.endswith(UNPLANNED) for shard in newest.shards):
        return None
    return (
        f"Its trials wait for the stage's plan, which organizers begin after its close at {rules.closes:%F %T} UTC. "
        "Stations then play all teams' trials by turns."
    )


def _workers(known: Fleet, evaluator_version: str, track: str, tasks: tuple[str, ...], needs_gpu: bool) -> WorkersView:
    """Return who can run some tasks, which may be of several families, each with workers of its own."""
    any_family = known.alive(evaluator_version)
    families = sorted({find_family(track, task) for task in tasks})
    alive = {family: known.alive(evaluator_version, family, needs_gpu=needs_gpu).alive for family in families}
    missing = next((family for family in families if not known.alive(evaluator_version, family).alive), None)
    lacks_gpu = needs_gpu and bool(any_family.alive) and not known.alive(evaluator_version, needs_gpu=True).alive
    return WorkersView(
        alive=min(alive.values(), default=any_family.alive),
        lacks_gpu=lacks_gpu,
        missing_family=missing if any_family.alive else None,
        missing_evaluator=None if any_family.alive or not known.alive().alive else evaluator_version,
        last_heartbeat_at=any_family.last_heartbeat_at,
    )


def _ranks(newest: Evaluation, shown: _Shown) -> dict[str | None, RankView]:
    """Return the places of the submission by task; under None that of all tasks together."""
    submission = newest.submission
    if newest.state is not EvaluationState.COMPLETED or not submission.kind.form.runs_policy:
        return {}
    boards = shown.places(shown.find_stage(submission))
    return {task: places[submission.id] for task, places in boards.items() if submission.id in places}
