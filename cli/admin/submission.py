"""`vitac admin submission`: all teams' submissions."""

from typing import Annotated
from uuid import UUID

import typer
from sqlalchemy.orm import Session
from vitac.server.database.states import EvaluationState
from vitac.server.evaluations.archive_copies import compare_archives, list_archive_copies
from vitac.server.evaluations.near_copies import list_near_copies
from vitac.server.leaderboards import descriptions
from vitac.server.principals import CONSOLE
from vitac.server.submissions import clearance, disqualification, listing, runs
from vitac.server.views.evaluations import ArchiveCopyView, NearCopyView
from vitac.server.views.submissions import SubmissionView

from ..client.status import show as show_status
from ..service.database import load_settings, transaction
from ..terminal.output import AsJson, moment, percent, print_json, print_table
from .verbs import change

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

SubmissionId = Annotated[UUID, typer.Argument(help="Id of the submission.")]
Reason = Annotated[str, typer.Option(help="Why, in one line; the team sees it.")]
COLUMNS = ("submission", "team", "name", "track", "state", "episodes", "success", "steps", "submitted")


@app.command("list")
def list_submissions(
    team: Annotated[str | None, typer.Option(help="Only submissions of this team (name or id).")] = None,
    track: Annotated[str | None, typer.Option(help="Only submissions to this track.")] = None,
    state: Annotated[EvaluationState | None, typer.Option(help="Only submissions in this state.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="Maximum number of rows.")] = 50,
    before: Annotated[UUID | None, typer.Option(help="Only submissions older than this one.")] = None,
    as_json: AsJson = False,
) -> None:
    """List submissions, newest first."""
    with transaction() as session:
        found = listing.list_submissions(
            session, load_settings(), CONSOLE, track=track, state=state, team=team, before=before, limit=limit
        )
    if as_json:
        print_json(found.model_dump(mode="json"))
        return
    print_table(COLUMNS, [_row(item) for item in found.items], none="No such submission.")
    if found.next_before is not None:
        print(f"\nThere are older ones: --before {found.next_before}")


@app.command()
def show(submission: SubmissionId, as_json: AsJson = False) -> None:
    """Show a submission with its newest evaluation."""
    with transaction() as session:
        found = _view(session, submission).model_dump(mode="json")
    if as_json:
        print_json(found)
    else:
        show_status(found)


@app.command()
def copies(as_json: AsJson = False) -> None:
    """List submissions that are near copies of another team's earlier one, and models with similar archives.

    Near are episodes in which no action of the first eight env steps, or no motion commanded until then, differs by
    more than 0.02, or the states on the way by more than 0.1 mm. With half of the episodes or more a submission is
    listed, and not ranked until you clear it. An archive is listed with weights that correlate by 0.98 or, without
    weights, 80 % of common code; such a submission stays ranked.
    """
    with transaction() as session:
        near = compare_archives(session, CONSOLE, list_near_copies(session, CONSOLE))
        archives = list_archive_copies(session, CONSOLE)
    if as_json:
        print_json(
            {"near": [one.model_dump(mode="json") for one in near]}
            | {"archives": [one.model_dump(mode="json") for one in archives]}
        )
        return
    columns = ["submission", "team", "like", "of team", "task", "list", "near", "difference", "code", "weights"]
    print_table(columns, [_copy(one) for one in near], none="No submission is near another team's.")
    if archives:
        print("\nSimilar archives:")
        print_table(
            ["submission", "team", "like", "of team", "track", "code", "weights"],
            [_archive(one) for one in archives],
            none="",
        )


@change(app, question="Evaluate submission {submission} again?", done="queued {submission} again")
def requeue(session: Session, submission: SubmissionId) -> SubmissionView:
    """Evaluate all episodes of a submission again. Earlier results stay; the newest run is shown."""
    runs.run_again(session, CONSOLE, submission)
    return _view(session, submission)


@change(app, question="Cancel the evaluation of submission {submission}?", done="cancelled {submission}")
def cancel(session: Session, submission: SubmissionId) -> SubmissionView:
    """Cancel the evaluation of a submission; its workers stop within seconds."""
    runs.cancel(session, CONSOLE, submission)
    return _view(session, submission)


@change(app, question="Take submission {submission} off all boards?", done="disqualified {submission}")
def disqualify(session: Session, submission: SubmissionId, reason: Reason) -> SubmissionView:
    """Remove one submission from all boards; its team takes part as before. `reinstate` undoes it."""
    disqualification.disqualify(session, CONSOLE, submission, reason)
    return _view(session, submission)


@change(app, question="Put submission {submission} back on the boards?", done="reinstated {submission}")
def reinstate(session: Session, submission: SubmissionId) -> SubmissionView:
    """Put a disqualified submission back on the boards."""
    disqualification.reinstate(session, CONSOLE, submission)
    return _view(session, submission)


@change(app, question="Rank submission {submission} although it was found to be a copy?", done="cleared {submission}")
def clear(session: Session, submission: SubmissionId, reason: Reason) -> SubmissionView:
    """Put a submission that was found to be a copy back on the boards. `withdraw-clearance` undoes it."""
    clearance.clear(session, CONSOLE, submission, reason)
    return _view(session, submission)


@change(app, question="Count submission {submission} as a copy again?", done="withdrew the clearance of {submission}")
def withdraw_clearance(session: Session, submission: SubmissionId) -> SubmissionView:
    """Withdraw the clearance of a submission: it counts as a copy again."""
    clearance.withdraw(session, CONSOLE, submission)
    return _view(session, submission)


@change(app, question="Hide the description of {submission} from others?", done="removed it from {submission}")
def remove_description(session: Session, submission: SubmissionId, reason: Reason) -> SubmissionView:
    """Hide what a team wrote about its result from others. `restore-description` undoes it."""
    descriptions.remove(session, CONSOLE, submission, reason)
    return _view(session, submission)


@change(app, question="Let others see the description of {submission} again?", done="restored it of {submission}")
def restore_description(session: Session, submission: SubmissionId) -> SubmissionView:
    """Let others see a removed description again."""
    descriptions.restore(session, CONSOLE, submission)
    return _view(session, submission)


def _view(session: Session, submission: UUID) -> SubmissionView:
    return listing.get(session, load_settings(), CONSOLE, submission)


def _copy(found: NearCopyView) -> list[object]:
    return [
        found.submission_id,
        found.team,
        found.earlier_submission_id,
        found.earlier_team,
        found.task,
        "sealed" if found.sealed else "public",
        f"{found.near} of {found.episodes}",
        f"{found.difference:.5f}",
        percent(found.code),
        percent(found.weights),
    ]


def _archive(found: ArchiveCopyView) -> list[object]:
    return [
        found.submission_id,
        found.team,
        found.earlier_submission_id,
        found.earlier_team,
        found.track,
        percent(found.code),
        percent(found.weights),
    ]


def _row(item: SubmissionView) -> list[object]:
    evaluation = item.evaluation
    done = f"{evaluation.progress.episodes_done}/{evaluation.progress.episodes_total}"
    return [
        item.id,
        item.team.name,
        item.name,
        item.track,
        evaluation.state.value,
        done,
        percent(evaluation.success_rate),
        evaluation.mean_steps,
        moment(item.submitted_at),
    ]
