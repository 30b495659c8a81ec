"""`vitac admin results`: frozen boards, winners, the end, and the published files."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...service.database import transaction
from ...terminal.output import AsJson, percent, print_done, print_json, print_records, warn
from ..consent import Confirmed, DryRun, Yes, change_as_shown, change_transaction, resolve_confirmed
from .contest import ContestName

if TYPE_CHECKING:
    from sqlalchemy.orm import Session
    from vitac.server.confirmations import Concern
    from vitac.server.prizes.finishing import Winner

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

COLUMNS = ("track", "place", "team", "amount", "currency", "rank", "success_rate", "mean_steps", "total")


@app.command()
def freeze(contest: ContestName = None, dry_run: DryRun = False, as_json: AsJson = False) -> None:
    """Freeze the boards of all stages for everybody but organizers; `unfreeze` ends it."""
    from vitac.server.contest.freezing import freeze as freeze_boards
    from vitac.server.principals import CONSOLE

    with change_transaction(dry_run=dry_run) as session:
        freeze_boards(session, CONSOLE, contest)
    print_done("boards are frozen", {"frozen": True}, as_json=as_json)


@app.command()
def unfreeze(contest: ContestName = None, yes: Yes = False, dry_run: DryRun = False, as_json: AsJson = False) -> None:
    """Show all results again."""
    from vitac.server.contest.freezing import unfreeze as unfreeze_boards
    from vitac.server.principals import CONSOLE

    with change_transaction(dry_run=dry_run, question="Show all results on the boards again?", yes=yes) as session:
        unfreeze_boards(session, CONSOLE, contest)
    print_done("boards show all results", {"frozen": False}, as_json=as_json)


@app.command()
def winners(contest: ContestName = None, as_json: AsJson = False) -> None:
    """List who wins what: final, or by today's boards of the last stages."""
    from vitac.server.contest.contest import Contest
    from vitac.server.contest.view import disqualified_since_the_end
    from vitac.server.prizes.finishing import prizes_without_winner
    from vitac.server.prizes.finishing import winners as all_winners

    with transaction() as session:
        found = all_winners(session, contest)
        left = prizes_without_winner(session, found, contest)
        out = [each.team for each in disqualified_since_the_end(Contest.find(session, contest))]
    _print(found, left, none="Nobody wins yet.", as_json=as_json)
    if out:
        warn(f"disqualified after the end: {', '.join(out)}. `results finalize --again` decides without them.")


@app.command()
def finalize(
    again: Annotated[
        bool, typer.Option("--again", help="Of one that is final: without the teams that are disqualified now.")
    ] = False,
    contest: ContestName = None,
    confirm: Confirmed = None,
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """End the competition with the winners as they are now; with --again, decide them again afterwards."""
    from vitac.server.principals import CONSOLE
    from vitac.server.prizes.finishing import concerns_at_end, finalize_again, prizes_without_winner
    from vitac.server.prizes.finishing import finalize as finalize_results

    def change(session: "Session") -> "tuple[list[Winner], list[str], list[Concern]]":
        confirmed, concerns = resolve_confirmed(confirm, yes=yes and not dry_run), []
        if again:
            found = finalize_again(session, CONSOLE, contest)
        else:
            concerns = concerns_at_end(session, contest)
            found = finalize_results(session, CONSOLE, contest, confirmed=confirmed)
        return found, prizes_without_winner(session, found, contest), concerns

    change_as_shown(
        change,
        lambda shown: _print(shown[0], shown[1], none="Nobody wins.", as_json=as_json),
        "Replace the winners by these?" if again else "End the competition with these winners?",
        concerns=lambda shown: shown[2],
        yes=yes,
        dry_run=dry_run,
    )


@app.command()
def reopen(
    reason: Annotated[str, typer.Option(help="Why, for everybody to read.")],
    contest: ContestName = None,
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Reopen a final competition, for instance after an appeal; `finalize` ends it again."""
    from vitac.server.principals import CONSOLE
    from vitac.server.prizes.finishing import reopen as reopen_results

    question = "Reopen the competition? Its page shows this, with your reason."
    with change_transaction(dry_run=dry_run, question=question, yes=yes) as session:
        reopen_results(session, CONSOLE, reason, contest)
    print_done("the results are open again", {"final": False}, as_json=as_json)


@app.command()
def publish(
    folder: Annotated[Path, typer.Argument(help="New folder for the files.")],
    contest: ContestName = None,
    as_json: AsJson = False,
) -> None:
    """Write the results as JSON, CSV, a page to print and certificates."""
    from vitac.server.publishing.publishing import publish as publish_results

    with transaction() as session:
        written = [str(path) for path in publish_results(session, folder, contest)]
    if as_json:
        print_json(written)
    else:
        print("\n".join(written))


def _print(found: "list[Winner]", left: list[str], *, none: str, as_json: bool) -> None:
    """Print winners, and warn of prizes that nobody wins."""
    rows = [asdict(winner) for winner in found]
    if not as_json:
        rows = [row | {name: percent(row[name]) for name in ("success_rate", "total")} for row in rows]
    print_records(rows, COLUMNS, none=none, as_json=as_json)
    for sentence in left:
        warn(sentence)
    if not found and not left:
        warn("nobody wins: the competition has no prizes.")
