"""`vitac admin team`: teams of the competition."""

from datetime import timedelta
from typing import Annotated

import typer

from ..service.database import load_settings, open_service, transaction
from ..terminal.output import AsJson, print_json, print_pairs, print_record, print_records
from .consent import Yes, consented_transaction

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.command()
def add(
    name: Annotated[str, typer.Argument(help="The team's name, 2 to 64 characters.")],
    contact: Annotated[str | None, typer.Option(help="Where organizers reach the team.")] = None,
    as_json: AsJson = False,
) -> None:
    """Add a team and print its API token, which is shown only now."""
    from vitac.server.accounts import teams, tokens
    from vitac.server.accounts.principals import CONSOLE
    from vitac.server.db.states import Role

    settings = load_settings()
    with open_service(settings) as services, services.database.transaction() as session:
        team = teams.register(session, CONSOLE, name=name, contact=contact)
        issued = tokens.issue(
            session,
            CONSOLE,
            role=Role.TEAM,
            label="first token",
            team=team,
            lifetime=timedelta(days=settings.token_lifetime_days),
        )
        shown = teams.organizer_team_view(team).model_dump()
    if as_json:
        print_json({"team": shown, "secret": issued.secret})
        return
    print_pairs({"team": team.name, "id": team.id, "token": issued.secret})
    print("\nThe token is not shown again. Hand it to the team; it is used as VITAC_TOKEN.")


@app.command("list")
def list_teams(as_json: AsJson = False) -> None:
    """List all teams."""
    from vitac.server.accounts import teams

    with transaction() as session:
        found = [teams.organizer_team_view(team).model_dump() for team in teams.list_teams(session)]
    none = "No team yet; `vitac admin team add NAME` makes one."
    print_records(found, ("name", "contact", "created_at", "disqualified_for", "id"), none=none, as_json=as_json)


@app.command()
def show(
    team: Annotated[str, typer.Argument(help="Name or id.")],
    as_json: AsJson = False,
) -> None:
    """Show one team."""
    from vitac.server.accounts import teams

    with transaction() as session:
        found = teams.organizer_team_view(teams.find(session, team)).model_dump()
    print_record(found, as_json=as_json)


@app.command()
def disqualify(
    team: Annotated[str, typer.Argument(help="Name or id.")],
    reason: Annotated[str, typer.Option(help="Told to the team when it submits.")],
    yes: Yes = False,
) -> None:
    """Take a team off all boards and refuse its submissions; `reinstate` takes it back."""
    from vitac.server.accounts import teams
    from vitac.server.accounts.principals import CONSOLE

    with consented_transaction(f"Disqualify {team}?", yes=yes) as session:
        found = teams.find(session, team)
        teams.disqualify(session, CONSOLE, found, reason)
    print(f"disqualified {found.name}")


@app.command()
def reinstate(team: Annotated[str, typer.Argument(help="Name or id.")]) -> None:
    """Let a disqualified team take part again, with all its results."""
    from vitac.server.accounts import teams
    from vitac.server.accounts.principals import CONSOLE

    with transaction() as session:
        found = teams.find(session, team)
        teams.reinstate(session, CONSOLE, found)
    print(f"{found.name} takes part")
