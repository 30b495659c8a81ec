"""`vitac describe`: what a team writes about a public result, over the API."""

from __future__ import annotations

from typing import Annotated

import typer

from ..terminal.options import Server, TokenFile
from ..terminal.output import AsJson, print_record
from .http import make_client

FIELDS = ("text", "code", "paper", "discussion")


def command(
    submission: Annotated[str, typer.Argument(help="Id of a public submission.")],
    text: Annotated[str | None, typer.Option(help="Plain text of several lines.")] = None,
    code: Annotated[str | None, typer.Option(help="https address of the code.")] = None,
    paper: Annotated[str | None, typer.Option(help="https address of the paper.")] = None,
    discussion: Annotated[str | None, typer.Option(help="https address of a place to discuss it.")] = None,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Write about a public result of your team, or without options show what is written.

    Others read it on the result's page, the links also on the board. What you do not name stays; "" takes it away.
    """
    client, address = make_client(server, token_file), f"/api/v1/submissions/{submission}/description"
    found = client.call("GET", address)
    changes = {
        name: value for name, value in zip(FIELDS, (text, code, paper, discussion), strict=True) if value is not None
    }
    if changes:
        now = {name: found[name] for name in FIELDS} | {"base": found["revision"]}
        found = client.call("PUT", address, now | changes)
    print_record(found, as_json=as_json)
