"""`vitac admin worker`: the processes that evaluate."""

from datetime import UTC, datetime
from typing import Annotated
from uuid import UUID

import typer
from sqlalchemy.orm import Session
from vitac.server.db.models import Worker
from vitac.server.db.states import WorkerOrder
from vitac.server.principals import CONSOLE
from vitac.server.queue import workers

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
    return [_shown(session, worker) for worker in workers.list_workers(session)]


@show(app, "show")
def show_worker(session: Session, worker: WorkerId) -> dict[str, object]:
    """Show a worker and what it says about itself."""
    return _shown(session, workers.find(session, worker))


@change(app, done="worker {worker} takes no new shards, from its next heartbeat on")
def cordon(session: Session, worker: WorkerId) -> dict[str, object]:
    """Have a worker take no new shards; it finishes those that it runs."""
    return _shown(session, workers.give_order(session, CONSOLE, worker, WorkerOrder.CORDON))


@change(app, done="worker {worker} takes shards, from its next heartbeat on")
def uncordon(session: Session, worker: WorkerId) -> dict[str, object]:
    """Have a worker take shards again."""
    return _shown(session, workers.give_order(session, CONSOLE, worker, WorkerOrder.WORK))


@change(app, done="worker {worker} ends after the shards that it runs")
def drain(session: Session, worker: WorkerId) -> dict[str, object]:
    """Have a worker finish the shards that it runs, take no others, and end."""
    return _shown(session, workers.give_order(session, CONSOLE, worker, WorkerOrder.DRAIN))


def _shown(session: Session, worker: Worker) -> dict[str, object]:
    """Return a worker with the state that holds: what one that is lost has said last does not."""
    shards = workers.running_shards(session).get(worker.id, ())
    view = workers.worker_view(worker, load_settings(), now=datetime.now(UTC), shards=shards)
    return view.model_dump() | ({"state": LOST} if view.is_lost else {})
