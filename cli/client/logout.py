"""`vitac logout`: deletes the stored token, and revokes it with `--revoke`."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import typer

from . import credentials
from .http import make_client


def command(
    server: Annotated[str | None, typer.Option(help="Address of the service; default: that of the last login.")] = None,
    revoke: Annotated[bool, typer.Option("--revoke", help="Revoke the token, wherever it is used.")] = False,
) -> None:
    """Remove the stored token from this machine; the team and its other tokens stay."""
    client = make_client(server, None, with_token=False)
    token = credentials.find_stored_token(client.server)
    if token is None:
        print(f"not logged in at {client.server}")
        return
    if revoke:
        own = replace(client, token=token)
        own.revoke(own.me()["token"]["id"])
    credentials.forget(client.server)
    print(f"logged out at {client.server}")
