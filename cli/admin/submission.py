"""`vitac admin submission`: all teams' submissions."""

from typing import TYPE_CHECKING, Annotated
from uuid import UUID

import typer

from ..service.database import load_settings, transaction
from ..terminal.output import AsJson, moment, percent, print_done, print_json, print_table
from .consent import DryRun, Yes, change_transaction
from .state import known_state

if TYPE_CHECKING:
    from vitac.server.views.submissions import SubmissionView

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

SubmissionId = Annotated[UUID, typer.Argument(help="Id of the submission.")]
COLUMNS = ("submission", "team", "name", "track", "state", "episodes", "success", "steps", "submitted")


@app.command("list")
def list_submissions(
    team: Annotated[str | None, typer.Option(help="Only this team's (name or id).")] = None,
    track: Annotated[str | None, typer.Option(help="Only this track's.")] = None,
    state: Annotated[str | None, typer.Option(help="queued, running, completed, failed or cancelled.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="Maximum number of rows.")] = 50,
    before: Annotated[UUID | None, typer.Option(help="Only those older than this submission.")] = None,
    as_json: AsJson = False,
) -> None:
    """List submissions, newest first."""
    from vitac.server.principals import CONSOLE
    from vitac.server.submissions import listing

    wanted = None if state is None else known_state(state)
    with transaction() as session:
        found = listing.list_submissions(
            session, load_settings(), CONSOLE, track=track, state=wanted, team=team, before=before, limit=limit
        )
    if as_json:
        print_json(found.model_dump(mode="json"))
        return
    print_table(COLUMNS, [_row(item) for item in found.items], none="No such submission.")
    if found.next_before is not None:
        print(f"\nThere are older ones: --before {found.next_before}")


@app.command()
def show(
    submission: SubmissionId,
    as_json: AsJson = False,
) -> None:
    """Show a submission with its newest evaluation."""
    from vitac.server.principals import CONSOLE
    from vitac.server.submissions import listing

    from ..client.status import show as show_status

    with transaction() as session:
        found = listing.get(session, load_settings(), CONSOLE, submission).model_dump(mode="json")
    if as_json:
        print_json(found)
    else:
        show_status(found)


@app.command()
def requeue(
    submission: SubmissionId,
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Evaluate all episodes of a submission again. Earlier results stay; the newest run is shown."""
    from vitac.server.principals import CONSOLE
    from vitac.server.submissions import listing, runs

    question = f"Evaluate submission {submission} again?"
    with change_transaction(dry_run=dry_run, question=question, yes=yes) as session:
        runs.run_again(session, CONSOLE, submission)
        shown = listing.get(session, load_settings(), CONSOLE, submission).model_dump(mode="json")
    print_done(f"queued {submission} again", shown, as_json=as_json)


@app.command()
def cancel(
    submission: SubmissionId,
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Cancel the evaluation of a submission; its workers stop within seconds."""
    from vitac.server.principals import CONSOLE
    from vitac.server.submissions import listing, runs

    question = f"Cancel the evaluation of submission {submission}?"
    with change_transaction(dry_run=dry_run, question=question, yes=yes) as session:
        runs.cancel(session, CONSOLE, submission)
        shown = listing.get(session, load_settings(), CONSOLE, submission).model_dump(mode="json")
    print_done(f"cancelled {submission}", shown, as_json=as_json)


@app.command()
def disqualify(
    submission: SubmissionId,
    reason: Annotated[str, typer.Option(help="In one line, for the team to read.")],
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Remove one submission from all boards; its team takes part as before. `reinstate` undoes it."""
    from vitac.server.principals import CONSOLE
    from vitac.server.submissions import disqualification, listing

    question = f"Take submission {submission} off all boards?"
    with change_transaction(dry_run=dry_run, question=question, yes=yes) as session:
        disqualification.disqualify(session, CONSOLE, submission, reason)
        shown = listing.get(session, load_settings(), CONSOLE, submission).model_dump(mode="json")
    print_done(f"disqualified {submission}", shown, as_json=as_json)


@app.command()
def reinstate(
    submission: SubmissionId,
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Put a disqualified submission back on the boards."""
    from vitac.server.principals import CONSOLE
    from vitac.server.submissions import disqualification, listing

    question = f"Put submission {submission} back on the boards?"
    with change_transaction(dry_run=dry_run, question=question, yes=yes) as session:
        disqualification.reinstate(session, CONSOLE, submission)
        shown = listing.get(session, load_settings(), CONSOLE, submission).model_dump(mode="json")
    print_done(f"reinstated {submission}", shown, as_json=as_json)


def _row(item: "SubmissionView") -> list[object]:
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
