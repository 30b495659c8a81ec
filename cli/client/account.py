"""`vitac login`: checks a token and keeps it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from vitac.errors import VitacError

from ..terminal.output import AsJson, Server, TokenFile, print_json, print_pairs, print_records
from .http import Json, credentials_file, find_stored_token, forget_token, make_client, read_token, store_token


def whoami(
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Show team, token and quotas."""
    client = make_client(server, token_file)
    me = client.me()
    if as_json:
        print_json(me)
        return
    token = me["token"]
    print_pairs(
        {
            "server": client.server,
            "as": format_owner(me),
            **({"shown as": me["team"]["shown_as"]} if me["team"] is not None else {}),
            "token": token["label"],
            "expires": token["expires_at"] or "never",
        }
    )
    if me["quotas"]:
        print()
        print_records(me["quotas"], ("quota", "limit", "used", "opens_at"), none="", as_json=False)
    if me.get("stage_quotas"):
        print()
        has_several = len({use["competition"] for use in me["stage_quotas"]}) > 1
        columns = ("track", "stage", "quota", "limit", "used", "closes")
        shown = ("competition", *columns) if has_several else columns
        print_records(me["stage_quotas"], shown, none="", as_json=False)


def format_owner(me: Json) -> str:
    """Return the team's name, or that it is an organizer."""
    if me["team"] is not None:
        return str(me["team"]["name"])
    competition = (me["token"] or {}).get("competition")
    return f"organizer of {competition}" if competition else "organizer"


def login(
    server: Server = None,
    token_file: Annotated[
        Path | None, typer.Option(help="File with the API token; by default a prompt asks for it.")
    ] = None,
) -> None:
    """Check a token, read from a prompt or standard input, and store it for the other commands."""
    client = make_client(server, None, with_token=False)
    if token_file is not None:
        token = read_token(token_file)
    elif sys.stdin.isatty():
        token = typer.prompt("API token", hide_input=True).strip()
    else:
        token = sys.stdin.readline().strip()
    me = replace(client, token=token).me()
    store_token(client.server, token)
    print(f"logged in at {client.server} as {format_owner(me)}; the token is stored in {credentials_file()}")


def logout(
    server: Annotated[str | None, typer.Option(help="Address of the service; default: that of the last login.")] = None,
    revoke: Annotated[bool, typer.Option("--revoke", help="Revoke the token, wherever it is used.")] = False,
) -> None:
    """Remove the stored token from this machine; the team and its other tokens stay."""
    client = make_client(server, None, with_token=False)
    token = find_stored_token(client.server)
    if token is None:
        print(f"not logged in at {client.server}")
        return
    if revoke:
        own = replace(client, token=token)
        own.revoke(own.me()["token"]["id"])
    forget_token(client.server)
    print(f"logged out at {client.server}")


class LoggedIn(VitacError):
    """A token for this service is stored already: log out first; the team stays."""


def register(
    name: Annotated[str, typer.Argument(help="Name of the team, 2 to 64 characters; shown on the leaderboard.")],
    contact: Annotated[str | None, typer.Option(help="Where organizers reach you; only they see it.")] = None,
    invite: Annotated[str | None, typer.Option(help="Invite code, where the service asks for one.")] = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Register a team, print its token, which is shown only once, and store it for the other commands."""
    client = make_client(server, None, with_token=False)
    if find_stored_token(client.server) is not None:
        raise LoggedIn(f"You are logged in at {client.server}; `vitac whoami` shows as whom, `vitac logout` ends it.")
    answer = client.register(name, contact=contact, invite=invite)
    secret = answer["token"]["secret"]
    # Before the token is stored, which may fail: it is shown only now.
    if as_json:
        print_json(answer)
    else:
        print_pairs({"team": answer["team"]["name"], "server": client.server, "token": secret})
    store_token(client.server, secret)
    if as_json:
        return
    print(
        f"\nThe token is stored in {credentials_file()}, for `vitac submit` and others. Sign in to the pages with it."
    )
