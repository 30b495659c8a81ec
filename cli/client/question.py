"""`vitac question`: questions to the organizers, over the API."""

from typing import Annotated

import typer

from ..terminal.options import Server, TokenFile
from ..terminal.output import AsJson, print_record, print_records
from .http import make_client

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

ADDRESS = "/api/v1/questions"


@app.command("list")
def list_questions(server: Server = None, token_file: TokenFile = None, as_json: AsJson = False) -> None:
    """List the team's questions and the public ones with their answers, newest first."""
    found = make_client(server, token_file).call("GET", ADDRESS)["items"]
    print_records(found, ("id", "team", "public", "text", "answer"), none="No question.", as_json=as_json)


@app.command()
def ask(
    text: Annotated[str, typer.Argument(help="The question, as plain text.")],
    public: Annotated[
        bool, typer.Option("--public/--private", help="Let everybody see the question, without the team's name.")
    ] = False,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Ask the organizers."""
    made = make_client(server, token_file).call("POST", ADDRESS, {"text": text, "public": public})
    print_record({name: made[name] for name in ("id", "public", "asked_at", "text")}, as_json=as_json)
