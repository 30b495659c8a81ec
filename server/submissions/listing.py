"""Views of submissions, one or a list, as everybody or their team may see them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any
from uuid import UUID

from sqlalchemy import ColumnElement, Float, func, null, select, tuple_
from sqlalchemy.orm import Session, joinedload
from vitac.evaluator.logs.findings import LogFinding

from ..accounts import teams
from ..accounts.shown_names import ShownNames
from ..accounts.teams import team_view
from ..cache import Cache
from ..competitions.competition import Competition, find_stage
from ..competitions.stages import Stage
from ..database.models import EpisodeResult, Evaluation, Submission
from ..database.states import EvaluationState
from ..errors import ProblemCode, ServiceError
from ..evaluations.copies import find_copies
from ..evaluations.episode_store import EpisodeKey, find_shown_key
from ..evaluations.history import histories, newest_evaluation, newest_state
from ..evaluations.logs import make_finding_views
from ..evaluations.scores import counted_tasks
from ..evaluations.view import EvaluationRows, evaluation_view, summary_view
from ..leaderboards.best_entries import Board, PlacesOfBoards, places
from ..leaderboards.descriptions import show_description
from ..leaderboards.public_pages import readable
from ..leaderboards.standings import explain_unranked_submission
from ..principals import Principal
from ..queue.work import UNPLANNED
from ..queue.workers import Fleet, fleet
from ..settings import Settings
from ..tracks import find_family, known_track
from ..views.evaluations import CopyView
from ..views.operations import WorkersView
from ..views.submissions import (
    ArchiveContents,
    EpisodeView,
    ModelCardView,
    RankView,
    SubmissionListView,
    SubmissionView,
)
from ..visibility import visible
from .kinds import SERVED_KINDS

_ends: Cache[tuple[UUID, str], Sequence[EpisodeView]] = Cache(at_most=128)
"""Episodes by evaluation and list, about 150 kB each. They do not change: a completed evaluation has all of them."""


def get(session: Session, settings: Settings, by: Principal, submission_id: UUID) -> SubmissionView:
    """Return one submission with its newest evaluation.

    Raises:
        ServiceError: there is none that the principal may see.
    """
    runs = histories(session, [readable(session, by, submission_id)], with_output=True)
    return submission_views(session, settings, runs, by, with_output=True)[0]


def list_submissions(
    session: Session,
    settings: Settings,
    by: Principal,
    *,
    competition: str | None = None,
    track: str | None = None,
    state: EvaluationState | None = None,
    team: str | None = None,
    before: UUID | None = None,
    limit: int = 50,
) -> SubmissionListView:
    """Return a page of the team's submissions, or of all teams' for organizers and judges; newest first.

    Raises:
        ServiceError: `competition`, `before` or `team` names nothing that the principal may see.
    """
    query = select(Submission).options(joinedload(Submission.team))
    if by.competition is not None:
        query = query.where(Submission.competition == by.competition)
    elif not by.reads_all_teams:
        query = query.where(Submission.team_id == by.team_id)
    if (by.reads_all_teams or by.competition is not None) and team is not None:
        query = query.where(Submission.team_id == teams.find(session, team).id)
    if competition is not None:
        query = query.where(Submission.competition == Competition.find(session, competition).name)
    if track is not None:
        query = query.where(Submission.track == track)
    if state is not None:
        query = query.where(newest_state() == state)
    if before is not None:
        last = visible(session, by, before)
        query = query.where(tuple_(Submission.submitted_at, Submission.id) < tuple_(last.submitted_at, last.id))
    rows = session.scalars(query.order_by(Submission.submitted_at.desc(), Submission.id.desc()).limit(limit + 1)).all()
    return SubmissionListView(
        items=submission_views(session, settings, histories(session, rows[:limit]), by),
        next_before=rows[limit - 1].id if len(rows) > limit else None,
    )


def episodes(session: Session, by: Principal, submission_id: UUID, *, practice: bool = False) -> Sequence[EpisodeView]:
    """Return how each finished episode of the newest evaluation ended, in order; none where they are not shown.

    Args:
        session: of the transaction.
        by: who asks.
        submission_id: of the submission.
        practice: of the public list that was played beside a sealed one, instead of those of the result.

    Raises:
        ServiceError: there is no such submission.
    """
    evaluation = newest_evaluation(session, readable(session, by, submission_id))
    return list_episodes(session, by, evaluation, practice=practice)


def list_episodes(
    session: Session, by: Principal, evaluation: Evaluation, *, practice: bool = False
) -> Sequence[EpisodeView]:
    """Return the same of an evaluation."""
    key = find_shown_key(session, by, evaluation, practice=practice)
    if key is None:
        return ()
    if evaluation.state is not EvaluationState.COMPLETED:
        return _read_episodes(session, key)
    return _ends.get((evaluation.id, key.commitment), lambda: _read_episodes(session, key))


def _read_episodes(session: Session, key: EpisodeKey) -> Sequence[EpisodeView]:
    rows = session.execute(
        select(
            EpisodeResult.task,
            EpisodeResult.episode,
            EpisodeResult.shape,
            EpisodeResult.initial_offset,
            EpisodeResult.outcome,
            EpisodeResult.success,
            EpisodeResult.env_steps,
            EpisodeResult.forces,
            _drawn(key.track).label("drawn"),
        )
        .where(*key.conditions())
        .order_by(EpisodeResult.task, EpisodeResult.episode)
    )
    return tuple(EpisodeView.from_row(row, draws=row.drawn or {}) for row in rows)


def _drawn(track: str) -> ColumnElement[Any]:
    """Return what was drawn for an episode, of a track that draws anything: reading whole records takes time."""
    known = known_track(track)
    draws = known is not None and any(task.draws for task in known.tasks.values())
    return EpisodeResult.record[("infos", 0, "draws")] if draws else null()


_times: Cache[UUID, float] = Cache(at_most=1024)
"""By evaluation: to sum them up, the database unpacks every record."""


def model_card(session: Session, by: Principal, submission_id: UUID) -> ModelCardView:
    """Return the card of a model.

    Raises:
        ServiceError: there is no such submission, or it is a log.
    """
    submission = readable(session, by, submission_id)
    if not submission.kind.form.has_card:
        raise ServiceError(
            ProblemCode.UNSUPPORTED_SUBMISSION_KIND,
            f"Expected a model, got a submission of kind {submission.kind}: only models have a card.",
        )
    return make_card(session, by, newest_evaluation(session, submission))


def make_card(session: Session, by: Principal, evaluation: Evaluation) -> ModelCardView:
    """Return the card of an evaluated model."""
    submission = evaluation.submission
    contents = submission.contents
    return ModelCardView.from_row(
        submission,
        observation_keys=submission.manifest.get("observation_keys"),
        control_modes=submission.manifest.get("control_modes") or {},
        contents=None if contents is None else ArchiveContents.model_validate(contents),
        policy_ms=_find_policy_ms(session, by, evaluation),
    )


def _find_policy_ms(session: Session, by: Principal, evaluation: Evaluation) -> float | None:
    key = find_shown_key(session, by, evaluation)
    if key is None or evaluation.state is not EvaluationState.COMPLETED:
        return None
    return _times.get(evaluation.id, lambda: _read_policy_ms(session, key))


def _read_policy_ms(session: Session, key: EpisodeKey) -> float:
    policy_s = EpisodeResult.record[("timings", "policy_s")].astext.cast(Float)
    total_s, env_steps = session.execute(
        select(func.sum(policy_s), func.sum(EpisodeResult.env_steps)).where(*key.conditions())
    ).one()
    return 1000.0 * (total_s or 0.0) / max(1, env_steps or 0)


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
