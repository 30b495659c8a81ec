"""Makes the view of a submission out of its rows; called by `listing` for the API and the pages."""

from collections.abc import Callable
from functools import partial

from sqlalchemy import select
from sqlalchemy.orm import Session
from vitac.evaluator.tracks import load_track
from vitac.server.db.models import EpisodeResult, Evaluation, Submission, Team
from vitac.server.db.states import TERMINAL_EVALUATION_STATES, EvaluationState, SubmissionKind
from vitac.server.evaluations.episode_store import EpisodeKey
from vitac.server.evaluations.history import history
from vitac.server.evaluations.lifecycle import LOG_TAIL_CHARACTERS
from vitac.server.evaluations.progress import progress_of, queue_position, seconds_to_end
from vitac.server.evaluations.provenance import isolation_levels
from vitac.server.evaluations.scores import bounds, combined_score, score_views
from vitac.server.evaluations.verdicts import sentence_of
from vitac.server.leaderboards.standings import PlacesOfBoards, places
from vitac.server.logs.view import log_view
from vitac.server.queue.workers import WorkersAlive, workers_alive
from vitac.server.settings import Settings
from vitac.server.views.accounts import TeamView
from vitac.server.views.evaluations import EvaluationSummaryView, EvaluationView, VerdictView
from vitac.server.views.submissions import RankView, SubmissionView
from vitac.server.views.workers import WorkersView

PlacesOf = Callable[[str], PlacesOfBoards]


def submission_view(
    session: Session, settings: Settings, submission: Submission, places_of: PlacesOf | None = None
) -> SubmissionView:
    """Return the submission with its newest evaluation.

    Args:
        session: of the transaction.
        settings: of this process.
        submission: whose view.
        places_of: gives the places on a track's boards, for those who show many submissions and read them once.
    """
    places_of = places_of or partial(places, session)
    runs = session.scalars(history(submission)).all()
    newest = runs[0]
    workers = workers_alive(session, settings, newest.evaluator_version)
    ranks = _ranks(submission, newest, places_of)
    return SubmissionView(
        id=submission.id,
        team=team_view(submission.team),
        kind=submission.kind,
        track=submission.track,
        tasks=submission.tasks,
        missing_tasks=_missing_tasks(submission),
        name=submission.name,
        digest=submission.digest,
        archive_sha256=submission.archive_sha256,
        archive_bytes=submission.archive_bytes,
        submitted_at=submission.submitted_at,
        evaluation=_evaluation_view(session, newest, submission, workers),
        evaluations=[_summary(evaluation) for evaluation in runs],
        workers=WorkersView(alive=workers.alive, last_heartbeat_at=workers.last_heartbeat_at),
        rank=ranks.get(None),
        task_ranks={task: place for task, place in ranks.items() if task is not None},
        log=log_view(session, submission, newest) if submission.kind is not SubmissionKind.MODEL else None,
    )


def _missing_tasks(submission: Submission) -> list[str]:
    """Return what a model does not play; a log is of one task and no other is missed."""
    if submission.kind is not SubmissionKind.MODEL:
        return []
    return [task for task in load_track(submission.track).tasks if task not in submission.tasks]


def team_view(team: Team) -> TeamView:
    """Return a team as it is shown."""
    return TeamView(id=team.id, name=team.name, created_at=team.created_at)


def _ranks(submission: Submission, newest: Evaluation, places_of: PlacesOf) -> dict[str | None, RankView]:
    """Places of the submission by task; under None that of all tasks together."""
    if newest.state is not EvaluationState.COMPLETED:
        return {}
    boards = places_of(submission.track)
    return {task: places[submission.id] for task, places in boards.items() if submission.id in places}


def _evaluation_view(
    session: Session, evaluation: Evaluation, submission: Submission, workers: WorkersAlive
) -> EvaluationView:
    progress = progress_of(session, evaluation, submission)
    combined = combined_score(evaluation)
    return EvaluationView(
        **dict(_summary(evaluation)),
        started_at=evaluation.started_at,
        queue_position=queue_position(session, evaluation),
        eta_s=seconds_to_end(session, evaluation, progress, workers.slots),
        progress=progress,
        verdict=_verdict(evaluation),
        log_tail=_log_tail(session, evaluation, submission),
        success_rate=combined.success_rate if combined else None,
        success_rate_interval=bounds(combined.interval) if combined else None,
        mean_steps=combined.mean_steps if combined else None,
        scores=score_views(evaluation),
        evaluator_hash=evaluation.evaluator_hash,
        platform_class=evaluation.platform_class,
        isolation=isolation_levels(session, evaluation),
    )


def _verdict(evaluation: Evaluation) -> VerdictView | None:
    if evaluation.verdict_code is None:
        return None
    return VerdictView(
        code=evaluation.verdict_code,
        title=sentence_of(evaluation.verdict_code),
        message=evaluation.verdict_message or "",
        task=evaluation.verdict_task,
        episode=evaluation.verdict_episode,
    )


def _log_tail(session: Session, evaluation: Evaluation, submission: Submission) -> str:
    """Return what was kept at the end; while it runs, the output of the last episode that the policy failed in.

    Nothing for a log: no policy ran here, and the output that a log names could be anything.
    """
    if submission.kind is not SubmissionKind.MODEL:
        return ""
    if evaluation.state in TERMINAL_EVALUATION_STATES:
        return evaluation.log_tail
    tail = session.scalar(
        select(EpisodeResult.record["failure"]["output_tail"].astext)
        .where(*EpisodeKey.of(evaluation, submission).conditions(), EpisodeResult.outcome == "policy_failed")
        .order_by(EpisodeResult.created_at.desc())
        .limit(1)
    )
    return (tail or "")[-LOG_TAIL_CHARACTERS:]


def _summary(evaluation: Evaluation) -> EvaluationSummaryView:
    return EvaluationSummaryView.model_validate(evaluation, from_attributes=True)
