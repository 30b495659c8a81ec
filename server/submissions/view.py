"""Makes the view of a submission out of its rows; called by `listing` for the API and the pages."""

from collections.abc import Callable
from functools import partial

from sqlalchemy.orm import Session
from vitac.evaluator.tracks import load_track
from vitac.server.db.states import EvaluationState

from ..accounts.teams import team_view
from ..db.models import Evaluation, Submission
from ..evaluations.history import history
from ..evaluations.view import evaluation_view, summary_view
from ..leaderboards.best_entries import PlacesOfBoards, places
from ..queue.workers import workers_alive
from ..settings import Settings
from ..uploads.kinds import SERVED_KINDS
from ..views.submissions import RankView, SubmissionView
from ..views.workers import WorkersView

PlacesOf = Callable[[str], PlacesOfBoards]


def submission_view(
    session: Session,
    settings: Settings,
    submission: Submission,
    places_of: PlacesOf | None = None,
    *,
    for_organizer: bool = False,
) -> SubmissionView:
    """Return the submission with its newest evaluation.

    Args:
        session: of the transaction.
        settings: of this process.
        submission: whose view.
        places_of: gives the places on a track's boards, for those who show many submissions and read them once.
        for_organizer: show also what only organizers may see.
    """
    places_of = places_of or partial(places, session)
    runs = session.scalars(history(submission)).all()
    newest = runs[0]
    workers = workers_alive(session, settings, newest.evaluator_version)
    log_view = SERVED_KINDS[submission.kind].log_view
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
        evaluation=evaluation_view(session, newest, workers, for_organizer=for_organizer),
        evaluations=[summary_view(evaluation) for evaluation in runs],
        workers=WorkersView(alive=workers.alive, last_heartbeat_at=workers.last_heartbeat_at),
        rank=ranks.get(None),
        task_ranks={task: place for task, place in ranks.items() if task is not None},
        log=log_view(session, submission, newest) if log_view else None,
    )


def _missing_tasks(submission: Submission) -> list[str]:
    """Return what a model does not play; a log is of one task and no other is missed."""
    if not submission.kind.form.runs_policy:
        return []
    return [task for task in load_track(submission.track).tasks if task not in submission.tasks]


def _ranks(submission: Submission, newest: Evaluation, places_of: PlacesOf) -> dict[str | None, RankView]:
    """Places of the submission by task; under None that of all tasks together."""
    if newest.state is not EvaluationState.COMPLETED:
        return {}
    boards = places_of(submission.track)
    return {task: places[submission.id] for task, places in boards.items() if submission.id in places}
