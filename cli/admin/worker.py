"""`vitac admin worker`: the processes that evaluate."""

from typing import TYPE_CHECKING, Annotated, Any
from uuid import UUID

import typer

from ..service.database import transaction
from ..terminal.output import AsJson, moment, print_record, print_records

if TYPE_CHECKING:
    from vitac.server.db.models import Worker

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.command("list")
def list_workers(as_json: AsJson = False) -> None:
    """List the workers of the last week, the one heard last first."""
    from vitac.server.queue import workers

    with transaction() as session:
        found = [to_json(worker) for worker in workers.list_workers(session)]
    columns = ("id", "host", "pid", "slots", "state", "isolation", "heartbeat_at", "message")
    none = "No worker was heard in the last week; `vitac worker` starts one."
    print_records(found, columns, none=none, as_json=as_json)


@app.command()
def show(
    worker: Annotated[UUID, typer.Argument(help="Id of the worker.")],
    as_json: AsJson = False,
) -> None:
    """Show a worker and what it says about itself."""
    from vitac.server.db.models import Worker
    from vitac.server.errors import not_found

    with transaction() as session:
        found = session.get(Worker, worker)
        if found is None:
            raise not_found("worker", worker)
        shown = to_json(found)
    print_record(shown, as_json=as_json)


def to_json(worker: "Worker") -> dict[str, Any]:
    """Return what is shown of a worker."""
    return {
        "id": str(worker.id),
        "host": worker.host,
        "pid": worker.pid,
        "slots": worker.slots,
        "state": worker.state.value,
        "message": worker.message,
        "isolation": worker.isolation,
        "evaluator_version": worker.evaluator_version,
        "platform_class": worker.platform_class,
        "started_at": moment(worker.started_at),
        "heartbeat_at": moment(worker.heartbeat_at),
    }
