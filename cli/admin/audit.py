"""`vitac admin audit`: who changed what."""

import json
from typing import Annotated

import typer
from vitac.server.audit import entry_view, newest_entries

from ..service.database import transaction
from ..terminal.output import AsJson, moment, print_json, print_table

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def audit() -> None:
    """Read the audit log; nobody can change it."""


@app.command("list")
def list_entries(
    action: Annotated[str | None, typer.Option(help="Only this action, such as team.quota.")] = None,
    subject: Annotated[str | None, typer.Option(help="Only this thing, such as team:ID.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=10_000, help="Maximum number of rows.")] = 50,
    as_json: AsJson = False,
) -> None:
    """List the changes that people made, newest first: who, when, what, before and after."""
    with transaction() as session:
        found = [entry_view(entry) for entry in newest_entries(session, limit, action=action, subject=subject)]
    if as_json:
        print_json([entry.model_dump(mode="json") for entry in found])
        return
    rows = [
        [moment(entry.at), entry.actor, entry.action, entry.subject, _short(entry.before), _short(entry.after)]
        for entry in found
    ]
    print_table(("when", "who", "what", "of", "before", "after"), rows, none="No such change.")


def _short(values: dict[str, object] | None) -> str | None:
    text = json.dumps(values, ensure_ascii=False, default=str) if values else ""
    return text if len(text) <= 80 else f"{text[:79]}…"
