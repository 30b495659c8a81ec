"""`vitac register`: registers a team at a service and keeps its token."""

from __future__ import annotations

from typing import Annotated

import typer
from vitac.envs.errors import VitacError

from ..terminal.options import Server
from ..terminal.output import AsJson, print_json, print_pairs
from . import credentials
from .http import make_client


class LoggedIn(VitacError):
    """A token for this service is stored already: log out first; the team stays."""


def command(
    name: Annotated[str, typer.Argument(help="Name of the team, 2 to 64 characters; shown on the leaderboard.")],
    contact: Annotated[str | None, typer.Option(help="Where organizers reach you; only they see it.")] = None,
    invite: Annotated[str | None, typer.Option(help="Invite code, where the service asks for one.")] = None,
    server: Server = None,
    as_json: AsJson = False,
) -> None:
    """Register a team, print its token, which is shown only once, and store it for the other commands."""
    client = make_client(server, None, with_token=False)
    if credentials.find_stored_token(client.server) is not None:
        raise LoggedIn(f"You are logged in at {client.server}; `vitac whoami` shows as whom, `vitac logout` ends it.")
    answer = client.register(name, contact=contact, invite=invite)
    secret = answer["token"]["secret"]
    # Before the token is stored, which may fail: it is shown only now.
    if as_json:
        print_json(answer)
    else:
        print_pairs({"team": answer["team"]["name"], "server": client.server, "token": secret})
    credentials.keep(client.server, secret)
    if as_json:
        return
    print(
        f"\nThe token is stored in {credentials.path()}, for `vitac submit` and others. Sign in to the pages with it."
    )
