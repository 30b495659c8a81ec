"""The whole service in one process tree: database, HTTP server, workers. Called by `serve` and `demo`."""

from __future__ import annotations

import logging
import signal
import threading
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, TextIO

from . import worker_processes
from .database import open_service
from .web_server import WebServer, address_of
from .worker_processes import WorkerProcesses

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Iterator

    from vitac.server.db.engine import Database
    from vitac.server.settings import Settings

LOOK_AFTER_S = 0.5


@dataclass(frozen=True, kw_only=True)
class RunningService:
    """A service that answers at `address`; its workers are started when `workers.start` is called."""

    address: str
    database: Database
    workers: WorkerProcesses


@contextmanager
def running_service(
    settings: Settings,
    listener: socket.socket,
    *,
    workers: int,
    log: IO[bytes] | int,
    say: Callable[[str], None],
) -> Iterator[RunningService]:
    """Run database and HTTP server inside the block, and end them with all workers after it.

    Args:
        settings: settings of the service.
        listener: bound socket to serve at.
        workers: how many worker processes `RunningService.workers` will start.
        log: where workers write.
        say: told in a sentence when a worker has died.
    """
    from vitac.web.application import create

    with ExitStack() as stack:
        stack.callback(listener.close)
        services = stack.enter_context(open_service(settings))
        server = WebServer(app=create(services), listener=listener)
        stack.callback(server.stop)
        server.start()
        processes = WorkerProcesses(
            count=workers, log=log, environment=_environment(settings), say=say, command=worker_processes.COMMAND
        )
        stack.callback(processes.stop)
        yield RunningService(address=address_of(listener), database=services.database, workers=processes)


class StopRequest:
    """Waits for Ctrl-C or SIGTERM. A second one ends the process at once."""

    def __init__(self) -> None:
        self._asked = threading.Event()

    @contextmanager
    def listening(self) -> Iterator[StopRequest]:
        """Take the two signals inside the block."""
        numbers = (signal.SIGINT, signal.SIGTERM)
        before = {number: signal.signal(number, self._ask) for number in numbers}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @property
    def asked(self) -> bool:
        """Whether somebody asked to stop."""
        return self._asked.is_set()

    def wait(self, timeout_s: float) -> bool:
        """Wait for the request, at most so long; return whether it came."""
        return self._asked.wait(timeout_s)

    def look_after(self, workers: WorkerProcesses) -> None:
        """Keep the workers alive until the request comes."""
        while not self.wait(LOOK_AFTER_S):
            workers.look_after()

    def _ask(self, number: int, _frame: object) -> None:
        if self.asked:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        self._asked.set()


def log_to(stream: TextIO) -> None:
    """Send the log of this process (ours and the libraries') to a stream, one line per event."""
    import structlog

    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            structlog.processors.KeyValueRenderer(key_order=["timestamp", "level", "event"]),
        ],
        logger_factory=structlog.PrintLoggerFactory(stream),
        cache_logger_on_first_use=False,
    )
    logging.basicConfig(
        stream=stream, level=logging.WARNING, force=True, format="%(asctime)s %(levelname)s %(name)s %(message)s"
    )


def _environment(settings: Settings) -> dict[str, str]:
    """Return what a worker must know that came from our command line and not from the environment."""
    return {"VITAC_STATE_DIR": str(settings.state_dir), "VITAC_WORKER_SLOTS": str(settings.worker_slots)}
