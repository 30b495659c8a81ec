"""Runs the whole service as one process tree: database, HTTP server, workers. Called by `serve` and `demo`."""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING

from . import process_pool
from .database import open_service
from .process_pool import ProcessPool
from .web_server import WebServer, address_of

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Iterator

    from vitac.server.db.engine import Database
    from vitac.server.settings import Settings


@dataclass(frozen=True, kw_only=True)
class RunningService:
    """A service that answers at `address`; `workers.start` starts its workers."""

    address: str
    database: Database
    workers: ProcessPool


@contextmanager
def running_service(
    settings: Settings,
    listener: socket.socket,
    *,
    workers: int,
    log: IO[bytes] | int,
    notify: Callable[[str], None],
) -> Iterator[RunningService]:
    """Run database and HTTP server inside the block; stop them and all workers after it.

    Args:
        settings: settings of the service.
        listener: bound socket to serve at.
        workers: number of worker processes that `RunningService.workers` starts.
        log: file that the workers write their service events to.
        notify: called with a sentence when a worker has ended.
    """
    from vitac.web.application import create

    with ExitStack() as stack:
        stack.callback(listener.close)
        services = stack.enter_context(open_service(settings))
        server = WebServer(app=create(services), listener=listener, trusted_proxies=settings.trusted_proxy_networks)
        stack.callback(server.stop)
        server.start()
        pool = ProcessPool(
            count=workers, log=log, environment=_environment(settings), notify=notify, command=process_pool.COMMAND
        )
        stack.callback(pool.stop)
        yield RunningService(address=address_of(listener), database=services.database, workers=pool)


def _environment(settings: Settings) -> dict[str, str]:
    """Return the settings that workers need and that our command line may have changed."""
    return {"VITAC_STATE_DIR": str(settings.state_dir), "VITAC_WORKER_SLOTS": str(settings.worker_slots)}
