"""`vitac admin notice`: what goes to teams by e-mail and webhook."""

from typing import Annotated
from uuid import UUID

import typer

from ..service.database import transaction
from ..terminal.output import AsJson, print_record, print_records
from .consent import DryRun, change_transaction

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.command("list")
def list_notices(
    unsent: Annotated[bool, typer.Option("--unsent", help="Only those that wait or were given up.")] = False,
    limit: Annotated[int, typer.Option(min=1, max=10_000, help="Maximum number of rows.")] = 50,
    as_json: AsJson = False,
) -> None:
    """List notices, newest first."""
    from vitac.server.notices.outbox import newest, notice_view

    with transaction() as session:
        found = [notice_view(notice).model_dump() for notice in newest(session, limit, unsent_only=unsent)]
    columns = ("created_at", "kind", "channel", "target", "attempts", "sent_at", "given_up_at", "problem", "id")
    print_records(found, columns, none="No notice.", as_json=as_json)


@app.command()
def retry(
    notice: Annotated[UUID, typer.Argument(help="Id of the notice.")],
    dry_run: DryRun = False,
    as_json: AsJson = False,
) -> None:
    """Send a notice again that was given up."""
    from vitac.server.notices.outbox import notice_view
    from vitac.server.notices.outbox import retry as send_again
    from vitac.server.principals import CONSOLE

    with change_transaction(dry_run=dry_run) as session:
        shown = notice_view(send_again(session, CONSOLE, notice)).model_dump()
    print_record(shown, as_json=as_json)
