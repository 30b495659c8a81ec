"""`vitac admin worker`: the processes that evaluate."""

from typing import Annotated
from uuid import UUID

import typer
from sqlalchemy.orm import Session
from vitac.server.queue import workers
from vitac.server.views.workers import WorkerView

from .verbs import list_records, show

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@list_records(
    app,
    *("id", "host", "pid", "slots", "state", "isolation", "heartbeat_at", "message"),
    none="No worker has run in the last week; `vitac worker` starts one.",
)
def list_workers(session: Session) -> list[WorkerView]:
    """List the workers of the last week, the one with the newest heartbeat first."""
    return [workers.worker_view(worker) for worker in workers.list_workers(session)]


@show(app, "show")
def show_worker(session: Session, worker: Annotated[UUID, typer.Argument(help="Id of the worker.")]) -> WorkerView:
    """Show a worker and what it says about itself."""
    return workers.worker_view(workers.find(session, worker))
