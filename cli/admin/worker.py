"""`vitac admin worker`: the processes that evaluate."""

from typing import Annotated
from uuid import UUID

import typer

from ..service.database import transaction
from ..terminal.output import AsJson, print_record, print_records

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.command("list")
def list_workers(as_json: AsJson = False) -> None:
    """List the workers of the last week, the one with the newest heartbeat first."""
    from vitac.server.queue import workers

    with transaction() as session:
        found = [workers.worker_view(worker).model_dump() for worker in workers.list_workers(session)]
    columns = ("id", "host", "pid", "slots", "state", "isolation", "heartbeat_at", "message")
    none = "No worker has run in the last week; `vitac worker` starts one."
    print_records(found, columns, none=none, as_json=as_json)


@app.command()
def show(
    worker: Annotated[UUID, typer.Argument(help="Id of the worker.")],
    as_json: AsJson = False,
) -> None:
    """Show a worker and what it says about itself."""
    from vitac.server.queue import workers

    with transaction() as session:
        shown = workers.worker_view(workers.find(session, worker)).model_dump()
    print_record(shown, as_json=as_json)
