"""`vitac admin token`: API tokens of teams, organizers and judges."""

from datetime import timedelta
from typing import Annotated
from uuid import UUID

import typer
from sqlalchemy.orm import Session
from vitac.server.accounts import teams, tokens
from vitac.server.database.states import Role
from vitac.server.principals import CONSOLE
from vitac.server.views.teams import TokenView

from ..service.database import load_settings
from ..terminal.output import AsJson, print_json, print_pairs
from .consent import DryRun, change_transaction
from .verbs import change, list_records

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.command()
def add(
    team: Annotated[
        str | None, typer.Argument(help="Name or id of the team; none with --organizer or --judge.")
    ] = None,
    organizer: Annotated[
        bool,
        typer.Option(
            "--organizer", help="A token that may do everything, or with --competition everything in one competition."
        ),
    ] = False,
    judge: Annotated[
        bool, typer.Option("--judge", help="A token that reads all teams' submissions and gives marks.")
    ] = False,
    competition: Annotated[
        str | None, typer.Option("--competition", help="With --organizer: the only competition that the token is for.")
    ] = None,
    label: Annotated[str | None, typer.Option(help="What the token is for; for a judge, the judge's name.")] = None,
    days: Annotated[
        int | None, typer.Option(min=1, help="Days until it expires; default: VITAC_TOKEN_LIFETIME_DAYS.")
    ] = None,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Add a token and print it; it is shown only once.

    `--organizer --competition NAME` is for somebody who organizes one of several competitions and sees no other.
    """
    if (team is not None) + organizer + judge != 1:
        raise typer.BadParameter("give one of TEAM, --organizer and --judge")
    if judge and label is None:
        raise typer.BadParameter("name the judge with --label: marks and conflicts of interest are stored under it")
    if competition is not None and not organizer:
        raise typer.BadParameter("--competition is for --organizer: only an organizer's token is for one competition")
    role = Role.ORGANIZER if organizer else Role.JUDGE if judge else Role.TEAM
    with change_transaction(dry_run=dry_run) as session:
        issued = tokens.issue(
            session,
            CONSOLE,
            role=role,
            label=label or "added by an organizer",
            team=None if team is None else teams.find(session, team),
            competition=competition,
            lifetime=timedelta(days=days or load_settings().token_lifetime_days),
        )
        shown = tokens.new_token_view(issued).model_dump() | ({"id": None, "secret": None} if dry_run else {})
    if as_json:
        print_json(shown)
        return
    print_pairs(shown)
    if not dry_run:
        print("\nThe secret is not shown again. It is used as VITAC_TOKEN.")


@list_records(
    app, "id", "role", "team", "competition", "label", "expires_at", "revoked_at", "last_used_at", none="No token yet."
)
def list_tokens(session: Session) -> list[TokenView]:
    """List all tokens, without their secrets."""
    return [tokens.token_view(token) for token in tokens.list_tokens(session, CONSOLE)]


@change(app, question="Revoke token {token}? This cannot be undone.", done="revoked {token}")
def revoke(
    session: Session, token: Annotated[UUID, typer.Argument(help="Id of the token (not its secret).")]
) -> TokenView:
    """Revoke a token; this cannot be undone."""
    return tokens.token_view(tokens.revoke(session, CONSOLE, token))
