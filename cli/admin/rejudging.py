"""`vitac admin rejudge`: submissions evaluated again beside their results, applied or discarded as one step."""

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated
from uuid import UUID

import typer

from ..service.database import transaction
from ..terminal.output import AsJson, percent, print_done, print_json, print_records, print_table
from .consent import DryRun, Yes, change_as_shown, change_transaction
from .contest.contest import ContestName

if TYPE_CHECKING:
    from vitac.server.rejudging.comparison import RejudgedSubmission

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

RejudgementId = Annotated[UUID, typer.Argument(help="Id of the rejudgement.")]
COLUMNS = ("team", "submission", "state", "success", "new success", "steps", "new steps", "rank", "new rank", "note")


@app.command()
def start(
    track: Annotated[str, typer.Option(help="Of the submissions.")],
    reason: Annotated[str, typer.Option(help="Why, for the audit log.")],
    stage: Annotated[str | None, typer.Option(help="Of the competition; the one that opened last without it.")] = None,
    submission: Annotated[
        list[UUID] | None, typer.Option(help="Only this one; may be repeated. All models of the stage without it.")
    ] = None,
    contest: ContestName = None,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Evaluate submissions again with the present evaluator; nobody but organizers sees it, no result changes."""
    from vitac.server.contest.contest import Contest
    from vitac.server.principals import CONSOLE
    from vitac.server.rejudging import rejudging
    from vitac.server.rejudging.comparison import comparison

    with change_transaction(dry_run=dry_run) as session:
        found = Contest.find(session, contest, track=track).shown_stage(track, stage)
        made = rejudging.start(session, CONSOLE, found, submissions=submission or (), reason=reason)
        count = len(comparison(session, made))
    if dry_run:
        print_done(f"{count} submissions", {"id": None, "submissions": count}, as_json=as_json)
        return
    sentence = f"rejudgement {made.id} of {count} submissions; see `vitac admin rejudge show`"
    print_done(sentence, {"id": made.id, "submissions": count}, as_json=as_json)


@app.command("list")
def list_rejudgements(as_json: AsJson = False) -> None:
    """List all rejudgements, newest first."""
    from vitac.server.principals import CONSOLE
    from vitac.server.rejudging.rejudging import rejudgements

    with transaction() as session:
        found = [
            {
                "id": str(each.id),
                "track": each.track,
                "stage": each.stage,
                "reason": each.reason,
                "started_at": each.started_at,
                "applied_at": each.applied_at,
                "discarded_at": each.discarded_at,
            }
            for each in rejudgements(session, CONSOLE)
        ]
    print_records(found, tuple(found[0]) if found else (), none="There is none.", as_json=as_json)


@app.command()
def show(rejudgement: RejudgementId, as_json: AsJson = False) -> None:
    """Show which scores and ranks would change."""
    from vitac.server.principals import CONSOLE
    from vitac.server.rejudging import rejudging
    from vitac.server.rejudging.comparison import comparison

    with transaction() as session:
        found = comparison(session, rejudging.find(session, CONSOLE, rejudgement))
    _print(found, as_json=as_json)


@app.command()
def apply(rejudgement: RejudgementId, yes: Yes = False, dry_run: DryRun = False, as_json: AsJson = False) -> None:
    """Make the new results those of their submissions; the present ones leave the boards."""
    from vitac.server.principals import CONSOLE
    from vitac.server.rejudging import rejudging

    change_as_shown(
        lambda session: rejudging.apply(session, CONSOLE, rejudgement),
        lambda found: _print(found, as_json=as_json),
        "Replace the present results by these?",
        yes=yes,
        dry_run=dry_run,
    )


@app.command()
def discard(rejudgement: RejudgementId, yes: Yes = False, dry_run: DryRun = False, as_json: AsJson = False) -> None:
    """Leave all present results as they are."""
    from vitac.server.principals import CONSOLE
    from vitac.server.rejudging import rejudging

    with change_transaction(dry_run=dry_run, question="Discard the new results?", yes=yes) as session:
        rejudging.discard(session, CONSOLE, rejudgement)
    print_done(f"discarded {rejudgement}", {"id": rejudgement, "discarded": True}, as_json=as_json)


def _print(found: "list[RejudgedSubmission]", *, as_json: bool) -> None:
    if as_json:
        print_json([asdict(row) | {"submission": str(row.submission)} for row in found])
        return
    print_table(COLUMNS, [_row(row) for row in found], none="It has no submissions.")
    print(f"{sum(row.changes for row in found)} of {len(found)} submissions would change score or rank")


def _row(row: "RejudgedSubmission") -> list[object]:
    pairs = [(percent(row.before.success_rate), percent(row.after.success_rate))]
    pairs += [(getattr(row.before, name), getattr(row.after, name)) for name in ("mean_steps", "rank")]
    note = "keeps its result" if row.keeps_result else row.after.verdict or ("changes" if row.changes else None)
    return [row.team, row.submission, row.state.value, *(cell for pair in pairs for cell in pair), note]
