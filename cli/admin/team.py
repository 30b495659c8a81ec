"""`vitac admin team`: teams of the competition."""

from typing import TYPE_CHECKING, Annotated

import typer

from ..service.database import load_settings, transaction
from ..terminal.output import AsJson, print_json, print_pairs, print_record, print_records, warn
from .consent import DryRun, Yes, change_transaction

if TYPE_CHECKING:
    from collections.abc import Callable

    from sqlalchemy.orm import Session
    from vitac.server.db.models import Team

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

TeamName = Annotated[str, typer.Argument(help="Name or id.")]


@app.command()
def add(
    name: Annotated[str, typer.Argument(help="The team's name, 2 to 64 characters.")],
    contact: Annotated[str | None, typer.Option(help="Where organizers reach the team.")] = None,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Add a team and print its API token, which is shown only now."""
    from vitac.server.members.registration import NewTeam, register
    from vitac.server.principals import CONSOLE
    from vitac.server.teams import teams

    with change_transaction(dry_run=dry_run) as session:
        team, issued = register(session, load_settings(), CONSOLE, NewTeam(name=name, contact=contact))
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
    waiting: Annotated[bool, typer.Option("--waiting", help="Only those that wait to be accepted.")] = False,
    as_json: AsJson = False,
) -> None:
    """List all teams."""
    from vitac.server.teams import teams

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
    from vitac.server.members import members
    from vitac.server.principals import CONSOLE
    from vitac.server.teams import teams

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


@app.command()
def accept(team: TeamName, dry_run: DryRun = False, as_json: AsJson = False) -> None:
    """Accept a team that waits or was refused; it may submit then."""
    from vitac.server.principals import CONSOLE
    from vitac.server.teams import teams

    _change(team, lambda session, found: teams.accept(session, CONSOLE, found), dry_run=dry_run, as_json=as_json)


@app.command()
def refuse(
    team: TeamName,
    reason: Annotated[str, typer.Option(help="Sent to the team.")],
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Refuse a team that waits to be accepted."""
    from vitac.server.principals import CONSOLE
    from vitac.server.teams import teams

    _change(
        team, lambda session, found: teams.refuse(session, CONSOLE, found, reason), dry_run=dry_run, as_json=as_json
    )


@app.command()
def rename(
    team: TeamName,
    name: Annotated[str, typer.Argument(help="The new name, 2 to 64 characters.")],
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Give a team another name."""
    from vitac.server.principals import CONSOLE
    from vitac.server.teams import teams

    _change(team, lambda session, found: teams.rename(session, CONSOLE, found, name), dry_run=dry_run, as_json=as_json)


@app.command()
def captain(
    team: TeamName,
    member: Annotated[str, typer.Argument(help="Name of the member who leads the team from now on.")],
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Make another member the captain."""
    from vitac.server.members import members
    from vitac.server.principals import CONSOLE

    def change(session: "Session", found: "Team") -> None:
        members.hand_over(session, CONSOLE, members.find_by_name(session, found, member))

    _change(team, change, dry_run=dry_run, as_json=as_json)


@app.command("remove-member")
def remove_member(
    team: TeamName,
    member: Annotated[str, typer.Argument(help="Name of the member.")],
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Remove a member from a team; their token ends at once."""
    from vitac.server.members import members
    from vitac.server.principals import CONSOLE

    def change(session: "Session", found: "Team") -> None:
        members.remove(session, CONSOLE, members.find_by_name(session, found, member))

    _change(team, change, question=f"Remove {member} from {team}?", yes=yes, dry_run=dry_run, as_json=as_json)


@app.command()
def data(team: TeamName, as_json: AsJson = False) -> None:
    """Show how much data the service stores about a team; --json prints all of it."""
    from vitac.server.principals import CONSOLE
    from vitac.server.team_data import export
    from vitac.server.teams import teams

    with transaction() as session:
        found = export(session, load_settings(), CONSOLE, teams.find(session, team)).model_dump(mode="json")
    if as_json:
        print_json(found)
        return
    lists = {"members": found["team"]["members"]} | {name: part for name, part in found.items() if type(part) is list}
    print_pairs({"team": found["team"]["name"]} | {name.replace("_", " "): len(part) for name, part in lists.items()})
    print("\n--json prints all of it.")


@app.command()
def delete(team: TeamName, yes: Yes = False, dry_run: DryRun = False, as_json: AsJson = False) -> None:
    """Remove a team's name, people, texts and uploads permanently; its scores stay."""
    from vitac.server.principals import CONSOLE
    from vitac.server.team_data import erase

    _change(
        team,
        lambda session, found: erase(session, CONSOLE, found),
        question=f"Remove {team} with all that it uploaded for good?",
        yes=yes,
        dry_run=dry_run,
        as_json=as_json,
    )


@app.command()
def merge(
    team: Annotated[str, typer.Argument(help="Name or id of the team that ends.")],
    into: Annotated[str, typer.Argument(help="Name or id of the team that gets its submissions and members.")],
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Merge two teams: submissions and members are joined, and what both used of quotas is added up."""
    from vitac.server.principals import CONSOLE
    from vitac.server.teams import merging, teams

    def change(session: "Session", found: "Team") -> None:
        merging.merge(session, CONSOLE, teams.find(session, team), found)

    _change(into, change, question=f"Merge {team} into {into} for good?", yes=yes, dry_run=dry_run, as_json=as_json)


@app.command()
def disqualify(
    team: TeamName,
    reason: Annotated[str, typer.Option(help="Shown to the team when it submits.")],
    yes: Yes = False,
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Remove a team from all boards and refuse its submissions; `reinstate` undoes it."""
    from vitac.server.contest.contest import Contest
    from vitac.server.contest.view import disqualified_since_the_end
    from vitac.server.principals import CONSOLE
    from vitac.server.teams import teams

    kept: list[str] = []

    def change(session: "Session", found: "Team") -> None:
        teams.disqualify(session, CONSOLE, found, reason)
        session.flush()
        final = (disqualified_since_the_end(contest) for contest in Contest.read_all(session))
        kept.extend(each.team for teams in final for each in teams if each.team == found.name)

    _change(team, change, question=f"Disqualify {team}?", yes=yes, dry_run=dry_run, as_json=as_json)
    if kept and not dry_run:
        warn(
            f"the results are final: {kept[0]} is struck through there; `results finalize --again` decides without it."
        )


@app.command()
def reinstate(team: TeamName, yes: Yes = False, dry_run: DryRun = False, as_json: AsJson = False) -> None:
    """Let a disqualified team take part again, with all its results."""
    from vitac.server.principals import CONSOLE
    from vitac.server.teams import teams

    _change(
        team,
        lambda session, found: teams.reinstate(session, CONSOLE, found),
        question=f"Reinstate {team}, with all its results on the boards?",
        yes=yes,
        dry_run=dry_run,
        as_json=as_json,
    )


def _change(
    team: str,
    change: "Callable[[Session, Team], None]",
    *,
    dry_run: bool,
    as_json: bool,
    question: str | None = None,
    yes: bool = False,
) -> None:
    """Change a team and print what it is then."""
    from vitac.server.teams import teams

    with change_transaction(dry_run=dry_run, question=question, yes=yes) as session:
        found = teams.find(session, team)
        change(session, found)
        session.flush()
        shown = teams.organizer_team_view(session, found).model_dump(mode="json")
    print_record(shown, as_json=as_json)
