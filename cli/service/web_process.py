"""One of several processes that answer requests at the same socket (`VITAC_SERVER_PROCESSES`).

`process_tree` starts them. They use the database, which stays with the process that started them.
"""

from __future__ import annotations

import signal
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection, HTTPException
from typing import TYPE_CHECKING

from vitac.evaluator.parent_death import end_with_parent

from .database import load_settings
from .process_pool import ProcessPool
from .stop_request import StopRequest
from .web_server import BACKLOG, START_LIMIT_S, ServerDidNotStart, WebServer, configure_events, no_collections

if TYPE_CHECKING:
    from vitac.server.services import Services

COMMAND = ("-c", "import sys; from vitac.cli.service.web_process import main; main(*map(int, sys.argv[1:]))")
POLL_S = 0.05
STATEMENT_TIMEOUT_S = 15.0
"""A request whose statement takes longer is answered with a sentence instead."""


def main(listener: int, parent: int) -> None:
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
