"""`vitac admin worker`: the processes that evaluate."""

from typing import Annotated
from uuid import UUID

import typer
from sqlalchemy.orm import Session
from vitac.server.database.states import WorkerOrder
from vitac.server.principals import CONSOLE
from vitac.server.queue import workers
from vitac.server.views.workers import WorkerView

from ..service.database import load_settings
from .verbs import change, list_records, show

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


WorkerId = Annotated[UUID, typer.Argument(help="Id of the worker.")]
LOST = "lost"


@list_records(
    app,
    *("id", "host", "pid", "state", "evaluator_version", "shards", "isolation", "heartbeat_at", "message"),
    none="No worker has run in the last week; `vitac worker` starts one.",
)
def list_workers(session: Session) -> list[dict[str, object]]:
    """List the workers of the last week, the one with the newest heartbeat first."""
    return [_shown(view) for view in workers.list_views(session, load_settings())]


@show(app, "show")
def show_worker(session: Session, worker: WorkerId) -> dict[str, object]:
    """Show a worker: its state, versions and shards."""
    return _shown(workers.view_worker(session, load_settings(), worker))


@change(app, done="worker {worker} takes no new shards, from its next heartbeat on")
def cordon(session: Session, worker: WorkerId) -> dict[str, object]:
    """Have a worker take no new shards; it finishes those that it runs."""
    workers.give_order(session, CONSOLE, worker, WorkerOrder.CORDON)
    return _shown(workers.view_worker(session, load_settings(), worker))


@change(app, done="worker {worker} takes shards, from its next heartbeat on")
def uncordon(session: Session, worker: WorkerId) -> dict[str, object]:
    """Have a worker take shards again."""
    workers.give_order(session, CONSOLE, worker, WorkerOrder.WORK)
    return _shown(workers.view_worker(session, load_settings(), worker))


@change(app, done="worker {worker} ends after the shards that it runs")
def drain(session: Session, worker: WorkerId) -> dict[str, object]:
    """Have a worker finish the shards that it runs, take no others, and end."""
    workers.give_order(session, CONSOLE, worker, WorkerOrder.DRAIN)
    return _shown(workers.view_worker(session, load_settings(), worker))


def _shown(view: WorkerView) -> dict[str, object]:
    """Return a worker with the state that holds: what one that is lost has said last does not."""
    return view.model_dump() | ({"state": LOST} if view.is_lost else {})
