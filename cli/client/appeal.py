"""`vitac appeal`: appeals of the own team, over the API."""

from typing import Annotated

import typer

from ..terminal.options import Server, TokenFile
from ..terminal.outcomes import print_meanings
from ..terminal.output import AsJson, print_json, print_record, print_records
from .http import make_client

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

ADDRESS = "/api/v1/appeals"
AppealNumber = Annotated[int, typer.Argument(min=1, max=2_147_483_647, help="Number of the appeal.")]


@app.command("list")
def list_appeals(server: Server = None, token_file: TokenFile = None, as_json: AsJson = False) -> None:
    """List the team's appeals, newest first."""
    found = make_client(server, token_file).call("GET", ADDRESS)["items"]
    columns = ("id", "state", "submission_name", "task", "episode", "opened_at", "ruling")
    print_records(found, columns, none="No appeal.", as_json=as_json)


@app.command("open")
def open_appeal(
    submission: Annotated[str, typer.Argument(help="Id of the submission, as `vitac status` prints it.")],
    text: Annotated[str, typer.Argument(help="What went wrong, as plain text.")],
    task: Annotated[str | None, typer.Option(help="Task in which it went wrong; needs --episode.")] = None,
    episode: Annotated[int | None, typer.Option(min=1, help="Number of the episode; needs --task.")] = None,
    server: Server = None,
    token_file: TokenFile = None,
    as_json: AsJson = False,
) -> None:
    """Appeal against the newest evaluation of a submission."""
    new = {"submission_id": submission, "text": text, "task": task, "episode": episode}
    made = make_client(server, token_file).call("POST", ADDRESS, new)
    print_record({name: value for name, value in made.items() if name != "replays"}, as_json=as_json)


@app.command()
def show(appeal: AppealNumber, server: Server = None, token_file: TokenFile = None, as_json: AsJson = False) -> None:
    """Show an appeal, its ruling, and what was played again for it."""
    found = make_client(server, token_file).call("GET", f"{ADDRESS}/{appeal}")
    if as_json:
        print_json(found)
        return
    replays = found.pop("replays")
    print_record(found, as_json=False)
    print()
    columns = ("task", "episode", "corrected", "old_outcome", "outcome", "same_states")
    print_records(replays, columns, none="No episode was played again.", as_json=False)
    print_meanings(end for replay in replays for end in (replay["old_outcome"], replay["outcome"]))


@app.command()
def withdraw(
    appeal: AppealNumber, server: Server = None, token_file: TokenFile = None, as_json: AsJson = False
) -> None:
    """Withdraw an appeal that is not decided yet."""
    found = make_client(server, token_file).call("POST", f"{ADDRESS}/{appeal}/withdraw")
    print_record({name: found[name] for name in ("id", "state", "ended_at")}, as_json=as_json)
