"""`vitac admin rejudge`: submissions evaluated again beside their results, applied or discarded as one step."""

from typing import Annotated
from uuid import UUID

import typer
from sqlalchemy.orm import Session
from vitac.server.competitions.competition import Competition
from vitac.server.decisions import rejudging
from vitac.server.decisions.rejudging import rejudgements
from vitac.server.decisions.rejudging_comparison import comparison
from vitac.server.principals import CONSOLE
from vitac.server.views.rejudging import RejudgedSubmissionView

from ..service.database import transaction
from ..terminal.output import AsJson, percent, print_done, print_json, print_table
from .competition.competition import CompetitionName
from .consent import DryRun, Yes, change_as_shown, change_transaction
from .verbs import change, list_records

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

RejudgementId = Annotated[UUID, typer.Argument(help="Id of the rejudgement.")]
COLUMNS = ("team", "submission", "state", "success", "new success", "steps", "new steps", "rank", "new rank", "note")


@app.command()
def start(
    track: Annotated[str, typer.Option(help="Track of the submissions.")],
    reason: Annotated[str, typer.Option(help="Why they are evaluated again, for the audit log.")],
    stage: Annotated[str | None, typer.Option(help="Name of the stage; by default the one that opened last.")] = None,
    submission: Annotated[
        list[UUID] | None, typer.Option(help="Only this submission; may be repeated. Default: all models of the stage.")
    ] = None,
    competition: CompetitionName = None,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Evaluate submissions again with the present evaluator. Only organizers see it, and no result changes."""
    with change_transaction(dry_run=dry_run) as session:
        found = Competition.find(session, competition, track=track).shown_stage(track, stage)
        made = rejudging.start(session, CONSOLE, found, submissions=submission or (), reason=reason)
        count = len(comparison(session, made))
    if dry_run:
        print_done(f"{count} submissions", {"id": None, "submissions": count}, as_json=as_json)
        return
    sentence = f"rejudgement {made.id} of {count} submissions; see `vitac admin rejudge show`"
    print_done(sentence, {"id": made.id, "submissions": count}, as_json=as_json)


@list_records(app, "id", "track", "stage", "reason", "started_at", "applied_at", "discarded_at", none="There is none.")
def list_rejudgements(session: Session) -> list[dict[str, object]]:
    """List all rejudgements, newest first."""
    shown = ("id", "track", "stage", "reason", "started_at", "applied_at", "discarded_at")
    return [{name: getattr(each, name) for name in shown} for each in rejudgements(session, CONSOLE)]


@app.command()
def show(rejudgement: RejudgementId, as_json: AsJson = False) -> None:
    """Show which scores and ranks would change."""
    with transaction() as session:
        found = comparison(session, rejudging.find(session, CONSOLE, rejudgement))
    _print(found, as_json=as_json)


@app.command()
def apply(rejudgement: RejudgementId, yes: Yes = False, dry_run: DryRun = False, as_json: AsJson = False) -> None:
    """Replace the present results by the new ones."""
    change_as_shown(
        lambda session: rejudging.apply(session, CONSOLE, rejudgement),
        lambda found: _print(found, as_json=as_json),
        "Replace the present results by these?",
        yes=yes,
        dry_run=dry_run,
    )


@change(app, question="Discard the new results?", done="discarded {rejudgement}")
def discard(session: Session, rejudgement: RejudgementId) -> dict[str, object]:
    """Discard the new results."""
    rejudging.discard(session, CONSOLE, rejudgement)
    return {"id": rejudgement, "discarded": True}


def _print(found: list[RejudgedSubmissionView], *, as_json: bool) -> None:
    if as_json:
        print_json([row.model_dump() for row in found])
        return
    print_table(COLUMNS, [_row(row) for row in found], none="It has no submissions.")
    print(f"{sum(row.changes for row in found)} of {len(found)} submissions would change score or rank")


def _row(row: RejudgedSubmissionView) -> list[object]:
    pairs = [(percent(row.before.success_rate), percent(row.after.success_rate))]
    pairs += [(getattr(row.before, name), getattr(row.after, name)) for name in ("mean_steps", "rank")]
    note = "keeps its result" if row.keeps_result else row.after.verdict or ("changes" if row.changes else None)
    return [row.team, row.submission, row.state.value, *(cell for pair in pairs for cell in pair), note]
