"""`vitac publish`, `describe` and `choose`: what a team decides about a submission of its own."""

from __future__ import annotations

from typing import Annotated

import typer

from ..terminal.output import AsJson, Server, TokenFile, print_json, print_record
from .http import make_client
from .verbs import Yes, require_consent


def publish(
    submission: Annotated[str, typer.Argument(help="Id of a submission.")],
    off: Annotated[bool, typer.Option("--off", help="Make it private again.")] = False,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Let everybody see the page of a submission: score, episodes and playbacks, nothing that the policy printed."""
    client = make_client(server, token_file)
    answer = client.set_public(submission, public=not off)
    if as_json:
        print_json(answer)
    elif not answer["public"]:
        print("private: only your team, judges and organizers see it")
    elif answer["evaluation"]["state"] != "completed":
        print(f"public as soon as its evaluation is complete: {client.server}/submissions/{answer['id']}")
    else:
        print(f"public: {client.server}/submissions/{answer['id']}")


def choose(
    submission: Annotated[str, typer.Argument(help="Id of a submission.")],
    off: Annotated[bool, typer.Option("--off", help="Take the choice back.")] = False,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Choose a submission for the final list of its stage, which is played after the close and alone decides.

    A stage says how many a team may choose, mostly one: of more the newest choices count. Without a choice your best
    submissions on the live list play it.
    """
    content = {"chosen": not off}
    answer = make_client(server, token_file).call("PUT", f"/api/v1/submissions/{submission}/chosen", content)
    if as_json:
        print_json(answer)
    else:
        print(f"{answer['name']}: {'chosen for the final list' if answer['chosen'] else 'not chosen'}")


def withdraw(
    submission: Annotated[str, typer.Argument(help="Id of a submission of your team.")],
    undo: Annotated[bool, typer.Option("--undo", help="Put it back on the boards.")] = False,
    delete: Annotated[
        bool, typer.Option("--delete", help="Remove upload, description and output permanently, too; scores stay.")
    ] = False,
    yes: Yes = False,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Take a submission off all boards, and cancel what waits or runs of it; what it used of quotas stays used.

    Nobody but your team, judges and organizers sees it then. --undo, or uploading the same content, puts it back.
    """
    if undo and delete:
        raise typer.BadParameter("give one of --undo and --delete")
    client, address = make_client(server, token_file), f"/api/v1/submissions/{submission}"
    if delete:
        require_consent(f"Remove what you uploaded as {submission} permanently?", yes=yes)
        answer = client.call("DELETE", address)
    else:
        answer = client.call("DELETE" if undo else "PUT", f"{address}/withdrawal")
    if as_json:
        print_json(answer)
    elif delete:
        print("deleted: the upload is removed within a day")
    else:
        print("it is on the boards again" if undo else "withdrawn: it is on no board")


FIELDS = ("text", "code", "paper", "discussion")


def describe(
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
    answer = client.call("GET", address)
    changes = {
        name: value for name, value in zip(FIELDS, (text, code, paper, discussion), strict=True) if value is not None
    }
    if changes:
        now = {name: answer[name] for name in FIELDS} | {"base": answer["revision"]}
        answer = client.call("PUT", address, now | changes)
    print_record(answer, as_json=as_json)
