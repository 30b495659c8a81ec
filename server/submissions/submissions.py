"""Submissions: accepted in one transaction with their evaluation and jobs, read by their team, cancelled, run again."""

import asyncio
from collections.abc import AsyncGenerator
from dataclasses import dataclass
from functools import cache, partial
from typing import Any
from uuid import UUID

from sqlalchemy import ScalarSelect, Select, select, tuple_
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session, joinedload
from vitac.evaluator.version import evaluator_version
from vitac.server.accounts import teams
from vitac.server.accounts.audit import record
from vitac.server.accounts.principals import Principal
from vitac.server.db.engine import Database
from vitac.server.db.models import EpisodeResult, Evaluation, Submission, Team
from vitac.server.db.row_locks import lock_evaluation
from vitac.server.db.states import (
    ACTIVE_EVALUATION_STATES,
    TERMINAL_EVALUATION_STATES,
    EvaluationState,
    SubmissionKind,
)
from vitac.server.errors import ProblemCode, ServiceError, not_found
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.episode_store import EpisodeKey
from vitac.server.evaluations.verdicts import VERDICTS_ON_LOGS, ServiceVerdict
from vitac.server.leaderboards.standings import places
from vitac.server.settings import Settings
from vitac.server.submissions.view import submission_view
from vitac.server.views.views import EpisodeView, SubmissionListView, SubmissionView

WATCH_INTERVAL_S = 0.5


@dataclass(frozen=True, kw_only=True)
class CheckedUpload:
    """An upload that passed all checks and is stored."""

    kind: SubmissionKind
    track: str
    tasks: tuple[str, ...]
    name: str
    digest: str
    archive_sha256: str
    archive_bytes: int
    manifest: dict[str, Any]


def create(
    session: Session, by: Principal, upload: CheckedUpload, *, team: str | None = None, again: bool = False
) -> tuple[Submission, bool]:
    """Make the submission and its evaluation, or finds the one that exists; whether a new evaluation was started.

    The same content of the same team is one submission. While its evaluation is active or completed nothing new is
    started, unless `again` asks for a run that uses no stored episodes; after a cancel the run is taken up where it
    ended, after a failure a new run begins.

    Raises:
        ServiceError: an organizer named no team.
    """
    owner = _owner(session, by, team)
    submission = _find_or_add(session, owner, upload)
    run = _next_run(session, submission, again=again)
    if run is None:
        return submission, False
    lifecycle.start(session, submission, run)
    record(session, by, "submission.evaluate", f"submission:{submission.id}", {"run": run, "digest": upload.digest})
    return submission, True


def owner_name(session: Session, by: Principal, team: str | None) -> str:
    """Name of the team whose submission an upload becomes.

    Raises:
        ServiceError: an organizer named no team, or none that exists.
    """
    return _owner(session, by, team).name


def get(session: Session, settings: Settings, by: Principal, submission_id: UUID) -> SubmissionView:
    """One submission with its newest evaluation.

    Raises:
        ServiceError: there is none that the principal may see.
    """
    return submission_view(session, settings, visible(session, by, submission_id))


def list_submissions(
    session: Session,
    settings: Settings,
    by: Principal,
    *,
    track: str | None = None,
    state: EvaluationState | None = None,
    team: str | None = None,
    before: UUID | None = None,
    limit: int = 50,
) -> SubmissionListView:
    """Return a page of the team's submissions, or of all teams' for an organizer; newest first.

    Raises:
        ServiceError: `before` or `team` names nothing that the principal may see.
    """
    query = select(Submission).options(joinedload(Submission.team))
    if not by.is_organizer:
        query = query.where(Submission.team_id == by.team_id)
    elif team is not None:
        query = query.where(Submission.team_id == teams.find(session, team).id)
    if track is not None:
        query = query.where(Submission.track == track)
    if state is not None:
        query = query.where(_newest_state() == state)
    if before is not None:
        last = visible(session, by, before)
        query = query.where(tuple_(Submission.submitted_at, Submission.id) < tuple_(last.submitted_at, last.id))
    found = session.scalars(query.order_by(Submission.submitted_at.desc(), Submission.id.desc()).limit(limit + 1)).all()
    places_of = cache(partial(places, session))
    return SubmissionListView(
        items=[submission_view(session, settings, submission, places_of) for submission in found[:limit]],
        next_before=found[limit - 1].id if len(found) > limit else None,
    )


def cancel(session: Session, by: Principal, submission_id: UUID) -> None:
    """End the evaluation of a submission; its workers stop within seconds.

    Raises:
        ServiceError: there is no such submission, or its evaluation has ended.
    """
    submission = visible(session, by, submission_id)
    evaluation = lock_evaluation(session, newest_evaluation(session, submission).id)
    if evaluation.state in TERMINAL_EVALUATION_STATES:
        raise ServiceError(
            ProblemCode.NOT_CANCELLABLE,
            f"The evaluation of submission {submission.id} is {evaluation.state} already; there is nothing to cancel.",
            state=evaluation.state.value,
        )
    lifecycle.cancel(session, evaluation)
    record(session, by, "submission.cancel", f"submission:{submission.id}", {"evaluation": str(evaluation.id)})


def run_again(session: Session, by: Principal, submission_id: UUID) -> Submission:
    """Start a new run that plays all episodes anew; the earlier results stay.

    Raises:
        ServiceError: not an organizer, no such submission, or its evaluation is still active.
    """
    by.require_organizer()
    submission = visible(session, by, submission_id)
    session.execute(select(Submission.id).where(Submission.id == submission.id).with_for_update(key_share=True))
    run = _next_run(session, submission, again=True)
    if run is None:
        raise ServiceError(
            ProblemCode.NOT_REQUEUABLE, f"Submission {submission.id} is being evaluated; cancel that first."
        )
    lifecycle.start(session, submission, run)
    record(session, by, "submission.requeue", f"submission:{submission.id}", {"run": run})
    return submission


def episodes(session: Session, by: Principal, submission_id: UUID) -> list[EpisodeView]:
    """How each finished episode of the newest evaluation ended, in order.

    Raises:
        ServiceError: there is no such submission.
    """
    submission = visible(session, by, submission_id)
    key = EpisodeKey.of(newest_evaluation(session, submission), submission)
    rows = session.execute(
        select(
            EpisodeResult.task,
            EpisodeResult.episode,
            EpisodeResult.record["shape"].astext,
            EpisodeResult.outcome,
            EpisodeResult.success,
            EpisodeResult.env_steps,
        )
        .where(*key.conditions())
        .order_by(EpisodeResult.task, EpisodeResult.episode)
    )
    return [EpisodeView(**dict(zip(EpisodeView.model_fields, row, strict=True))) for row in rows]


def visible(session: Session, by: Principal, submission_id: UUID) -> Submission:
    """Return the submission of that id.

    Raises:
        ServiceError: there is none that the principal may see.
    """
    submission = session.get(Submission, submission_id, options=[joinedload(Submission.team)])
    if submission is None or not by.may_see(submission.team_id):
        raise not_found("submission", submission_id)
    return submission


def newest_evaluation(session: Session, submission: Submission) -> Evaluation:
    """Return the evaluation that a submission shows."""
    return session.scalars(_history(submission).limit(1)).one()


async def watch(
    database: Database, settings: Settings, by: Principal, submission_id: UUID
) -> AsyncGenerator[SubmissionView, None]:
    """Return the submission now and after each change, until its evaluation has ended.

    Raises:
        ServiceError: there is no such submission.
    """

    def look() -> SubmissionView:
        with database.transaction() as session:
            return get(session, settings, by, submission_id)

    last = None
    while True:
        view = await asyncio.to_thread(look)
        if view != last:
            yield view
        if view.evaluation.state in TERMINAL_EVALUATION_STATES:
            return
        last = view
        await asyncio.sleep(WATCH_INTERVAL_S)


def _owner(session: Session, by: Principal, team: str | None) -> Team:
    if not by.is_organizer:
        return teams.own(session, by)
    if team is None:
        raise ServiceError(ProblemCode.TEAM_REQUIRED, "An organizer's token belongs to no team; name one with `team`.")
    return teams.find(session, team)


def _find_or_add(session: Session, owner: Team, upload: CheckedUpload) -> Submission:
    """Return the row of this content, locked: two equal uploads at once go on one after the other."""
    session.execute(
        insert(Submission)
        .values(
            team_id=owner.id,
            kind=upload.kind,
            track=upload.track,
            tasks=list(upload.tasks),
            name=upload.name,
            digest=upload.digest,
            archive_sha256=upload.archive_sha256,
            archive_bytes=upload.archive_bytes,
            manifest=upload.manifest,
        )
        .on_conflict_do_nothing(
            index_elements=[Submission.team_id, Submission.track, Submission.kind, Submission.digest]
        )
    )
    return session.scalars(
        select(Submission)
        .where(
            Submission.team_id == owner.id,
            Submission.track == upload.track,
            Submission.kind == upload.kind,
            Submission.digest == upload.digest,
        )
        .with_for_update(key_share=True)
    ).one()


def _next_run(session: Session, submission: Submission, *, again: bool) -> int | None:
    """Return the number of the run to start, or None when the existing evaluation answers the request.

    A score answers it, and so does what was found against a log: its actions would lead to the same states again.
    """
    current = evaluator_version()
    history = session.scalars(_history(submission)).all()
    if any(evaluation.state in ACTIVE_EVALUATION_STATES for evaluation in history):
        return None
    same_version = [evaluation for evaluation in history if evaluation.evaluator_version == current]
    if not same_version:
        return 1
    newest = same_version[0]
    if not again and (newest.state is EvaluationState.COMPLETED or newest.verdict_code in VERDICTS_ON_LOGS):
        return None
    if not again and _can_be_taken_up(newest):
        return newest.run
    return 1 + max(evaluation.run for evaluation in same_version)


def _can_be_taken_up(evaluation: Evaluation) -> bool:
    by_machines = evaluation.verdict_code == ServiceVerdict.MACHINE_FAILED
    return evaluation.state is EvaluationState.CANCELLED or by_machines


def _history(submission: Submission) -> Select[Evaluation]:
    return (
        select(Evaluation)
        .where(Evaluation.submission_id == submission.id)
        .order_by(Evaluation.created_at.desc(), Evaluation.run.desc(), Evaluation.id)
        .execution_options(populate_existing=True)
    )


def _newest_state() -> ScalarSelect[EvaluationState]:
    return (
        select(Evaluation.state)
        .where(Evaluation.submission_id == Submission.id)
        .order_by(Evaluation.created_at.desc(), Evaluation.run.desc())
        .limit(1)
        .scalar_subquery()
    )
