"""`vitac admin team`: teams of the competition."""

from typing import Annotated

import typer
from sqlalchemy.orm import Session
from vitac.server.accounts import members, merging, teams
from vitac.server.accounts.registration import RegisteringTeam, register
from vitac.server.competitions.competition import Competition
from vitac.server.competitions.view import disqualified_since_the_end
from vitac.server.operations.team_data import erase, export
from vitac.server.principals import CONSOLE
from vitac.server.views.teams import OrganizerTeamView

from ..service.database import load_settings, transaction
from ..terminal.output import AsJson, print_json, print_pairs, print_record, print_records, warn
from .consent import DryRun, Yes, change_transaction
from .verbs import change

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

TeamName = Annotated[str, typer.Argument(help="Name or id.")]


@app.command()
def add(
    name: Annotated[str, typer.Argument(help="The team's name, 2 to 64 characters.")],
    contact: Annotated[str | None, typer.Option(help="Where organizers reach the team.")] = None,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Add a team and print its API token, which is shown only once."""
    with change_transaction(dry_run=dry_run) as session:
        team, issued = register(session, load_settings(), CONSOLE, RegisteringTeam(name=name, contact=contact))
        shown = teams.organizer_team_view(session, team).model_dump() | ({"id": None} if dry_run else {})
    secret = None if dry_run else issued.secret
    if as_json:
        print_json({"team": shown, "secret": secret})
        return
    print_pairs({"team": shown["name"], "id": shown["id"], "token": secret})
    if not dry_run:
        print("\nThe token is not shown again. Hand it to the team; it is used as VITAC_TOKEN.")


@app.command("list")
def list_teams(
    waiting: Annotated[bool, typer.Option("--waiting", help="Only teams that wait to be accepted.")] = False,
    as_json: AsJson = False,
) -> None:
    """List all teams."""
    with transaction() as session:
        listed = teams.waiting(session) if waiting else teams.list_teams(session)
        found = [teams.organizer_team_view(session, team).model_dump() for team in listed]
    none = "No team waits." if waiting else "No team yet; `vitac admin team add NAME` makes one."
    columns = ("name", "contact", "created_at", "approved_at", "refused_for", "disqualified_for", "id")
    print_records(found, columns, none=none, as_json=as_json)


@app.command()
def show(
    team: TeamName,
    as_json: AsJson = False,
) -> None:
    """Show one team with its members."""
    with transaction() as session:
        found = members.own_team_view(session, CONSOLE, teams.find(session, team)).model_dump(mode="json")
    if as_json:
        print_json(found)
        return
    people = found.pop("members")
    found["invitations"] = len(found["invitations"])
    print_pairs(found)
    print()
    print_records(people, ("name", "role", "email", "joined_at", "left_at"), none="", as_json=False)


@change(app)
def accept(session: Session, team: TeamName) -> OrganizerTeamView:
    """Accept a team that waits or was refused; it may submit then."""
    found = teams.find(session, team)
    teams.accept(session, CONSOLE, found)
    return teams.organizer_team_view(session, found)


@change(app)
def refuse(
    session: Session, team: TeamName, reason: Annotated[str, typer.Option(help="Why; it is sent to the team.")]
) -> OrganizerTeamView:
    """Refuse a team that waits to be accepted."""
    found = teams.find(session, team)
    teams.refuse(session, CONSOLE, found, reason)
    return teams.organizer_team_view(session, found)


@change(app)
def rename(
    session: Session, team: TeamName, name: Annotated[str, typer.Argument(help="The new name, 2 to 64 characters.")]
) -> OrganizerTeamView:
    """Give a team another name."""
    found = teams.find(session, team)
    teams.rename(session, CONSOLE, found, name)
    return teams.organizer_team_view(session, found)


@change(app)
def captain(
    session: Session,
    team: TeamName,
    member: Annotated[str, typer.Argument(help="Name of the member who leads the team from now on.")],
) -> OrganizerTeamView:
    """Make another member the captain."""
    found = teams.find(session, team)
    members.hand_over(session, CONSOLE, members.find_by_name(session, found, member))
    return teams.organizer_team_view(session, found)


@change(app, "remove-member", question="Remove {member} from {team}?")
def remove_member(
    session: Session, team: TeamName, member: Annotated[str, typer.Argument(help="Name of the member.")]
) -> OrganizerTeamView:
    """Remove a member from a team; their token ends at once."""
    found = teams.find(session, team)
    members.remove(session, CONSOLE, members.find_by_name(session, found, member))
    return teams.organizer_team_view(session, found)


@app.command()
def data(team: TeamName, as_json: AsJson = False) -> None:
    """Show how much data the service stores about a team; --json prints all of it."""
    with transaction() as session:
        found = export(session, load_settings(), CONSOLE, teams.find(session, team)).model_dump(mode="json")
    if as_json:
        print_json(found)
        return
    lists = {"members": found["team"]["members"]} | {name: part for name, part in found.items() if type(part) is list}
    print_pairs({"team": found["team"]["name"]} | {name.replace("_", " "): len(part) for name, part in lists.items()})
    print("\n--json prints all of it.")


@change(app, question="Remove {team} with all that it uploaded permanently?")
def delete(session: Session, team: TeamName) -> OrganizerTeamView:
    """Remove a team's name, members, texts and uploads permanently; its scores stay."""
    found = teams.find(session, team)
    erase(session, CONSOLE, found)
    return teams.organizer_team_view(session, found)


@change(app, question="Merge {team} into {into}? This cannot be undone.")
def merge(
    session: Session,
    team: Annotated[str, typer.Argument(help="Name or id of the team that ends.")],
    into: Annotated[str, typer.Argument(help="Name or id of the team that gets its submissions and members.")],
) -> OrganizerTeamView:
    """Merge two teams: join their submissions and members, and add up what they used of quotas."""
    found = teams.find(session, into)
    merging.merge(session, CONSOLE, teams.find(session, team), found)
    return teams.organizer_team_view(session, found)


@app.command()
def disqualify(
    team: TeamName,
    reason: Annotated[str, typer.Option(help="Shown to the team when it submits.")],
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Remove a team from all boards and refuse its submissions; `reinstate` undoes it."""
    with change_transaction(dry_run=dry_run, question=f"Disqualify {team}?", yes=yes) as session:
        found = teams.find(session, team)
        teams.disqualify(session, CONSOLE, found, reason)
        session.flush()
        final = [
            out for competition in Competition.read_all(session) for out in disqualified_since_the_end(competition)
        ]
        is_in_results = any(out.team == found.name for out in final)
        shown = teams.organizer_team_view(session, found).model_dump()
    print_record(shown, as_json=as_json)
    if is_in_results and not dry_run:
        name = shown["name"]
        warn(f"the results are final: {name} is struck through there; `results finalize --again` decides without it.")


@change(app, question="Reinstate {team}, with all its results on the boards?")
def reinstate(session: Session, team: TeamName) -> OrganizerTeamView:
    """Let a disqualified team take part again, with all its results."""
    found = teams.find(session, team)
    teams.reinstate(session, CONSOLE, found)
    return teams.organizer_team_view(session, found)
