"""`vitac admin results`: frozen boards, winners, the end, and the published files."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from sqlalchemy.orm import Session
from vitac.server.competitions import applying
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.view import disqualified_since_the_end
from vitac.server.confirmations import Concern
from vitac.server.decisions.finishing import Winner, concerns_at_end, finalize_again, prizes_without_winner
from vitac.server.decisions.finishing import finalize as finalize_results
from vitac.server.decisions.finishing import reopen as reopen_results
from vitac.server.decisions.finishing import winners as all_winners
from vitac.server.decisions.publishing import publish as publish_results
from vitac.server.principals import CONSOLE

from ...service.database import transaction
from ...terminal.output import AsJson, percent, print_json, print_records, warn
from ..consent import Confirmed, DryRun, Yes, change_as_shown, resolve_confirmed
from ..verbs import change
from .competition import CompetitionName

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

COLUMNS = ("track", "place", "team", "amount", "currency", "rank", "success_rate", "mean_steps", "total")


@change(app, done="boards are frozen")
def freeze(session: Session, competition: CompetitionName = None) -> dict[str, object]:
    """Freeze the boards of all stages for everybody but organizers; `unfreeze` ends it."""
    applying.freeze_boards(session, CONSOLE, competition)
    return {"frozen": True}


@change(app, question="Show all results on the boards again?", done="boards show all results")
def unfreeze(session: Session, competition: CompetitionName = None) -> dict[str, object]:
    """Show all results again."""
    applying.unfreeze_boards(session, CONSOLE, competition)
    return {"frozen": False}


@app.command()
def winners(competition: CompetitionName = None, as_json: AsJson = False) -> None:
    """List the winners: the final ones, or those by the present boards of the last stages."""
    with transaction() as session:
        found = all_winners(session, competition)
        left = prizes_without_winner(session, found, competition)
        out = [each.team for each in disqualified_since_the_end(Competition.find(session, competition))]
    _print(found, left, none="Nobody wins yet.", as_json=as_json)
    if out:
        warn(f"disqualified after the end: {', '.join(out)}. `results finalize --again` decides without them.")


@app.command()
def finalize(
    again: Annotated[
        bool, typer.Option("--again", help="Decide a final competition again, without teams that are disqualified now.")
    ] = False,
    competition: CompetitionName = None,
    confirm: Confirmed = None,
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """End the competition with the winners as they are now; with --again, decide them again afterwards."""

    def change(session: "Session") -> "tuple[list[Winner], list[str], list[Concern]]":
        confirmed, concerns = resolve_confirmed(confirm, yes=yes and not dry_run), []
        if again:
            found = finalize_again(session, CONSOLE, competition)
        else:
            concerns = concerns_at_end(session, competition)
            found = finalize_results(session, CONSOLE, competition, confirmed=confirmed)
        return found, prizes_without_winner(session, found, competition), concerns

    change_as_shown(
        change,
        lambda shown: _print(shown[0], shown[1], none="Nobody wins.", as_json=as_json),
        "Replace the winners by these?" if again else "End the competition with these winners?",
        concerns=lambda shown: shown[2],
        yes=yes,
        dry_run=dry_run,
    )


@change(
    app,
    question="Reopen the competition? Its page shows this, with your reason.",
    done="the results are open again",
)
def reopen(
    session: Session,
    reason: Annotated[str, typer.Option(help="Why it is reopened; everybody sees it.")],
    competition: CompetitionName = None,
) -> dict[str, object]:
    """Reopen a final competition, for instance after an appeal; `finalize` ends it again."""
    reopen_results(session, CONSOLE, reason, competition)
    return {"final": False}


@app.command()
def publish(
    folder: Annotated[Path, typer.Argument(help="New folder for the files.")],
    competition: CompetitionName = None,
    as_json: AsJson = False,
) -> None:
    """Write the results as JSON, CSV, a page to print and certificates."""
    with transaction() as session:
        written = [str(path) for path in publish_results(session, folder, competition)]
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
