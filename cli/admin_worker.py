"""`vitac admin worker`: the processes that evaluate."""

from typing import TYPE_CHECKING, Annotated, Any
from uuid import UUID

import typer

from .output import moment, print_json, print_pairs, print_table
from .service_database import transaction

if TYPE_CHECKING:
    from vitac.server.db.models import Worker

app = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@app.command("list")
def list_workers(as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False) -> None:
    """List the workers of the last week, the one heard last first."""
    from vitac.server import workers

    with transaction() as session:
        found = [to_json(worker) for worker in workers.list_workers(session)]
    if as_json:
        print_json(found)
        return
    columns = ["id", "host", "pid", "slots", "state", "isolation", "heartbeat_at", "message"]
    rows = [[row[key] for key in columns] for row in found]
    print_table(columns, rows, none="No worker was heard in the last week; `vitac worker` starts one.")


@app.command()
def show(
    worker: Annotated[UUID, typer.Argument(help="Id of the worker.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show a worker and what it says about itself."""
    from vitac.server.db.models import Worker
    from vitac.server.errors import not_found

    with transaction() as session:
        found = session.get(Worker, worker)
        if found is None:
            raise not_found("worker", worker)
        shown = to_json(found)
    if as_json:
        print_json(shown)
    else:
        print_pairs(shown)


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
