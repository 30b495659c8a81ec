"""`vitac team`: the own team and its members, over the API."""

import sys
from typing import Annotated

import typer
from vitac.server.database.states import NoticeKind

from ..terminal.options import Server, TokenFile
from ..terminal.output import AsJson, print_json, print_pairs, print_records
from . import credentials, webhook
from .http import Client, Json, make_client
from .own_team import NoTeam, own_path

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)
app.add_typer(webhook.app, name="webhook", help="Addresses that get the team's notices: list, add, remove.")

MemberName = Annotated[str, typer.Argument(help="The member's name, as `vitac team show` prints it.")]


@app.command()
def show(server: Server = None, token_file: TokenFile = None, as_json: AsJson = False) -> None:
    """Show the team, its members and its open invitations."""
    found = _own_team(make_client(server, token_file))
    if as_json:
        print_json(found)
        return
    print_pairs({"team": found["name"], "state": _state(found), "open invitations": len(found["invitations"])})
    print()
    present = [member for member in found["members"] if member["left_at"] is None]
    print_records(present, ("name", "role", "email", "has_password", "joined_at"), none="", as_json=False)


@app.command()
def data(server: Server = None, token_file: TokenFile = None) -> None:
    """Print all data that the service stores about the team, as JSON."""
    client = make_client(server, token_file)
    print_json(client.call("GET", f"{own_path(client)}/data"))


@app.command()
def invite(server: Server = None, token_file: TokenFile = None, as_json: AsJson = False) -> None:
    """Print a code with which one person joins the team; for its captain."""
    client = make_client(server, token_file)
    made = client.call("POST", f"{own_path(client)}/invitations")
    if as_json:
        print_json(made)
        return
    print_pairs({"code": made["code"], "until": made["expires_at"]})
    print("\nThe code is shown only once, and is valid for one person: `vitac team join CODE NAME`.")


@app.command()
def join(
    code: Annotated[str, typer.Argument(help="Code of the captain's invitation.")],
    name: Annotated[str, typer.Argument(help="Your name, for the team and the organizers.")],
    email: Annotated[str | None, typer.Option(help="Your e-mail address for notices.")] = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Join a team, print your token, which is shown only once, and store it for the other commands."""
    client = make_client(server, None, with_token=False)
    answer = client.call("POST", "/api/v1/teams/join", {"code": code, "name": name, "email": email})
    secret = answer["token"]["secret"]
    if as_json:
        print_json(answer)
    else:
        print_pairs({"team": answer["team"]["name"], "server": client.server, "token": secret})
    credentials.keep(client.server, secret)


@app.command()
def remove(member: MemberName, server: Server = None, token_file: TokenFile = None) -> None:
    """Remove a member, whose token ends at once; for the captain, or to leave the team."""
    client = make_client(server, token_file)
    client.call("DELETE", _path_of_member(client, member))
    print(f"{member} is no longer in the team")


@app.command()
def captain(member: MemberName, server: Server = None, token_file: TokenFile = None) -> None:
    """Make another member the captain."""
    client = make_client(server, token_file)
    team = _own_team(client)
    client.call("PUT", f"/api/v1/teams/{team['id']}/captain", {"member_id": _member(team, member)["id"]})
    print(f"{member} is the captain")


@app.command()
def email(
    member: MemberName,
    address: Annotated[str | None, typer.Argument(help="E-mail address; leave it out to get no e-mails.")] = None,
    server: Server = None,
    token_file: TokenFile = None,
) -> None:
    """Set the address to which your notices are sent."""
    client = make_client(server, token_file)
    client.call("PATCH", _path_of_member(client, member), {"email": address})
    print(f"notices of {member}: {address or 'none'}")
    if address is not None:
        print("A code was sent there; `vitac team confirm-email` with it, and notices follow.")


@app.command("confirm-email")
def confirm_email(
    member: MemberName,
    code: Annotated[str, typer.Argument(help="Code from the e-mail that asks to confirm the address.")],
    server: Server = None,
    token_file: TokenFile = None,
) -> None:
    """Confirm the address for your notices."""
    client = make_client(server, token_file)
    client.call("PATCH", _path_of_member(client, member), {"email_code": code})
    print(f"notices of {member} are sent from now on")


@app.command()
def mute(
    member: MemberName,
    kinds: Annotated[
        list[NoticeKind] | None, typer.Argument(help="Kinds of notices to mute; without any, you get all.")
    ] = None,
    server: Server = None,
    token_file: TokenFile = None,
) -> None:
    """Choose the notices that you do not want by e-mail; replaces the earlier choice."""
    client = make_client(server, token_file)
    muted = sorted(set(kinds or ()))
    client.call("PATCH", _path_of_member(client, member), {"muted": muted})
    print(f"{member} gets no notices of: {', '.join(muted)}" if muted else f"{member} gets all notices")


@app.command()
def password(member: MemberName, server: Server = None, token_file: TokenFile = None) -> None:
    """Set your password; an empty one removes it.

    It is read from a prompt, or from the first line of standard input; the second line is the old one if you have one.
    """
    client = make_client(server, token_file)
    if sys.stdin.isatty():
        old = typer.prompt("Old password (empty if you have none)", hide_input=True, default="", show_default=False)
        given = typer.prompt("New password", hide_input=True, confirmation_prompt=True, default="", show_default=False)
    else:
        given, old = (sys.stdin.readline().rstrip("\n") for _ in range(2))
    client.call("PATCH", _path_of_member(client, member), {"password": given or None, "old_password": old or None})
    print(f"{member} {'has a new' if given else 'has no'} password")


@app.command("renew-token")
def renew_token(
    member: MemberName, server: Server = None, token_file: TokenFile = None, as_json: AsJson = False
) -> None:
    """Replace your token: print and store a new one; the old one ends."""
    client = make_client(server, token_file)
    made = client.call("POST", f"{_path_of_member(client, member)}/token")
    if as_json:
        print_json(made)
    else:
        print_pairs({"token": made["secret"], "expires": made["expires_at"]})
    credentials.keep(client.server, made["secret"])


def _own_team(client: Client) -> Json:
    return client.call("GET", own_path(client))


def _path_of_member(client: Client, name: str) -> str:
    team = _own_team(client)
    return f"/api/v1/teams/{team['id']}/members/{_member(team, name)['id']}"


def _member(team: Json, name: str) -> Json:
    for member in team["members"]:
        if member["name"].casefold() == name.casefold() and member["left_at"] is None:
            return dict(member)
    raise NoTeam(f"{team['name']} has no member {name!r}; `vitac team show` lists them.")


def _state(team: Json) -> str:
    if team["disqualified_for"]:
        return f"disqualified: {team['disqualified_for']}"
    if team["refused_for"]:
        return f"refused: {team['refused_for']}"
    return "takes part" if team["approved_at"] else "waits until an organizer accepts it"
