"""Runs the whole service as one process tree: database, HTTP servers, workers. Called by `serve` and `demo`."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from http.client import HTTPConnection, HTTPException
from typing import IO, TYPE_CHECKING

from vitac.evaluator.parent_death import end_with_parent

from .database import load_settings, open_service
from .stop_request import StopRequest
from .web_server import (
    BACKLOG,
    START_LIMIT_S,
    ServerDidNotStart,
    WebServer,
    configure_events,
    format_address,
    no_collections,
)

if TYPE_CHECKING:
    from vitac.server.database.engine import Database
    from vitac.server.services import Services
    from vitac.server.settings import Settings


WORKER_COMMAND = ("-c", "import sys; from vitac.cli.main import main; main(['worker', '--end-with', sys.argv[1]])")
STOP_LIMIT_S = 15.0
RESTART_PAUSE_S = 2.0  # limits how often a worker that ends at once is restarted


@dataclass(kw_only=True)
class ProcessPool:
    """Several processes of one kind.

    Attributes:
        noun: what one of them is called.
        count: number of processes.
        log: file that they write their service events to.
        environment: added to this process's environment.
        notify: called with a sentence when one has ended.
        command: arguments of the Python interpreter that start one; our process id is appended.
        inherited: file descriptors that they keep.
    """

    noun: str = "worker"
    count: int
    log: IO[bytes] | int
    environment: dict[str, str] = field(default_factory=dict)
    notify: Callable[[str], None]
    command: Sequence[str] = WORKER_COMMAND
    inherited: Sequence[int] = ()
    _running: list[subprocess.Popen[bytes]] = field(default_factory=list, init=False)
    _not_before: float = field(default=0.0, init=False)

    @property
    def pids(self) -> list[int]:
        """Ids of the running processes."""
        return [process.pid for process in self._running]

    def start(self) -> None:
        """Start all. Call this in a thread that lives as long as they should: they end with it."""
        for _ in range(self.count):
            self._running.append(self._launch())

    def restart_ended(self) -> None:
        """Start a new process for each that has ended; call this regularly."""
        for process in [process for process in self._running if process.poll() is not None]:
            if time.monotonic() < self._not_before:
                return
            self._running.remove(process)
            self.notify(f"{self.noun} {process.pid} ended with code {process.returncode}; starting another one")
            self._running.append(self._launch())
            self._not_before = time.monotonic() + RESTART_PAUSE_S

    def stop(self) -> None:
        """Send all SIGTERM, and kill those that have not ended within the limit."""
        for process in self._running:
            process.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + STOP_LIMIT_S
        for process in self._running:
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._running.clear()

    def _launch(self) -> subprocess.Popen[bytes]:
        # A session of its own: Ctrl-C reaches only this process, which then stops the workers in order.
        return subprocess.Popen(  # noqa: S603 - our own interpreter and arguments
            [sys.executable, *self.command, str(os.getpid())],
            stdin=subprocess.DEVNULL,
            stdout=self.log,
            stderr=self.log,
            env=os.environ | self.environment,
            pass_fds=self.inherited,
            start_new_session=True,
        )


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
            command=(*WEB_PROCESS_COMMAND, str(listener.fileno())),
            inherited=[listener.fileno()],
        )
        if servers.count:
            stack.enter_context(_housekeeping(services))
            stack.callback(servers.stop)
            servers.start()
            wait_until_answering(listener, servers)
        else:
            stack.enter_context(serving(services, listener))
        pool = ProcessPool(count=workers, log=log, environment=environment, notify=notify, command=WORKER_COMMAND)
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


WEB_PROCESS_COMMAND = (
    "-c",
    "import sys; from vitac.cli.service.process_tree import run_web_process; run_web_process(*map(int, sys.argv[1:]))",
)
POLL_S = 0.05
STATEMENT_TIMEOUT_S = 15.0
"""A request whose statement takes longer is answered with a sentence instead."""


def run_web_process(listener: int, parent: int) -> None:
    """Answer requests until SIGTERM.

    Args:
        listener: descriptor of the socket.
        parent: process id of the process that started us; we end with it.
    """
    with no_collections():
        from vitac.server.services import open_services

    settings = load_settings()
    configure_events(sys.stderr, settings.log_format)
    end_with_parent(parent, signal.SIGTERM)
    # Until the services are open, which may take as long as the database is away, SIGTERM ends the process at once: it
    # holds the service's port, and whoever started it may be gone.
    with (
        open_services(settings, may_run_database=False, statement_timeout_s=STATEMENT_TIMEOUT_S) as services,
        StopRequest().listening() as stop,
        serving(services, socket.socket(fileno=listener), sweeps=False),
    ):
        while not stop.wait(3600.0):
            continue


@contextmanager
def serving(services: Services, listener: socket.socket, *, sweeps: bool = True) -> Iterator[None]:
    """Answer requests in a thread of this process while the block runs; close the socket after it.

    Args:
        services: what the application works with.
        listener: bound socket.
        sweeps: look for lost work; False where the process that started this one does.
    """
    with no_collections():
        from vitac.web.application import create

    trusted = services.settings.trusted_proxy_networks
    server = WebServer(app=create(services, sweeps=sweeps), listener=listener, trusted_proxies=trusted)
    try:
        server.start()
        yield
    finally:
        server.stop()


def wait_until_answering(listener: socket.socket, servers: ProcessPool) -> None:
    """Wait until one of the processes answers.

    Raises:
        ServerDidNotStart: none did in time.
    """
    listener.listen(BACKLOG)
    deadline = time.monotonic() + START_LIMIT_S
    while not _answers(listener):
        if time.monotonic() > deadline:
            raise ServerDidNotStart("No server process answers; `vitac serve` prints why.")
        servers.restart_ended()
        time.sleep(POLL_S)


def _answers(listener: socket.socket) -> bool:
    host, port = listener.getsockname()[:2]
    connection = HTTPConnection({"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host), port, timeout=START_LIMIT_S)  # noqa: S104
    try:
        connection.request("GET", "/health")
        return connection.getresponse().status == 200
    except (OSError, HTTPException):
        return False
    finally:
        connection.close()
