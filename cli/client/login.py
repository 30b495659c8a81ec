"""`vitac login`: checks a token and keeps it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ..terminal.options import Server
from . import credentials
from .http import make_client, read_token
from .whoami import format_owner


def command(
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
    credentials.keep(client.server, token)
    print(f"logged in at {client.server} as {format_owner(me)}; the token is stored in {credentials.path()}")
