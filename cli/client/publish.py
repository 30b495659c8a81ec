"""`vitac publish`: makes the result of a submission public, or private again."""

from __future__ import annotations

from typing import Annotated

import typer

from ..terminal.options import Server, TokenFile
from ..terminal.output import AsJson, print_json
from .http import make_client


def command(
    submission: Annotated[str, typer.Argument(help="Id of a submission.")],
    off: Annotated[bool, typer.Option("--off", help="Make it private again.")] = False,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Let everybody see the page of a submission: score, episodes and playbacks, nothing that the policy printed."""
    client = make_client(server, token_file)
    found = client.set_public(submission, public=not off)
    if as_json:
        print_json(found)
    elif not found["public"]:
        print("private: only your team, judges and organizers see it")
    elif found["evaluation"]["state"] != "completed":
        print(f"public as soon as its evaluation is complete: {client.server}/submissions/{found['id']}")
    else:
        print(f"public: {client.server}/submissions/{found['id']}")
