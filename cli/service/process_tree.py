"""Runs the whole service as one process tree: database, HTTP server, workers. Called by `serve` and `demo`."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING

from . import process_pool, web_process
from .database import open_service
from .process_pool import ProcessPool
from .web_process import STATEMENT_TIMEOUT_S, serving
from .web_server import format_address

if TYPE_CHECKING:
    from vitac.server.database.engine import Database
    from vitac.server.services import Services
    from vitac.server.settings import Settings


@dataclass(frozen=True, kw_only=True)
class RunningService:
    """A service that answers at `address`; `workers.start` starts its workers."""

    address: str
    database: Database
    workers: ProcessPool
    servers: ProcessPool

    def restart_ended(self) -> None:
        """Start a new process for each that has ended; call this regularly."""
        self.servers.restart_ended()
        self.workers.restart_ended()


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
        notify: called with a sentence when a server process or a worker has ended.
    """
    with ExitStack() as stack:
        stack.callback(listener.close)
        services = stack.enter_context(open_service(settings, statement_timeout_s=STATEMENT_TIMEOUT_S))
        environment = _environment(settings)
        servers = ProcessPool(
            noun="server",
            count=settings.server_processes if settings.server_processes > 1 else 0,
            log=log,
            environment=environment,
            notify=notify,
            command=(*web_process.COMMAND, str(listener.fileno())),
            inherited=[listener.fileno()],
        )
        if servers.count:
            stack.enter_context(_housekeeping(services))
            stack.callback(servers.stop)
            servers.start()
            web_process.wait_until_answering(listener, servers)
        else:
            stack.enter_context(serving(services, listener))
        pool = ProcessPool(count=workers, log=log, environment=environment, notify=notify, command=process_pool.COMMAND)
        stack.callback(pool.stop)
        yield RunningService(
            address=format_address(listener), database=services.database, workers=pool, servers=servers
        )


@contextmanager
def _housekeeping(services: Services) -> Iterator[None]:
    """Sweep and prune while the block runs: one process does it for all that answer requests."""
    from vitac.server.operations.housekeeping import Housekeeping

    housekeeping = Housekeeping(services)
    housekeeping.start()
    try:
        yield
    finally:
        housekeeping.stop()


def _environment(settings: Settings) -> dict[str, str]:
    """Return the settings that other processes need and that our command line may have changed."""
    return {"VITAC_STATE_DIR": str(settings.state_dir), "VITAC_WORKER_SLOTS": str(settings.worker_slots)}
