"""Runs the HTTP server in a thread of this process. Called by `serve` and `demo`."""

from __future__ import annotations

import gc
import logging
import resource
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TextIO

from vitac.errors import VitacError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import uvicorn
    from fastapi import FastAPI
    from structlog.typing import Processor
    from vitac.server.settings import LogFormat

BACKLOG = 2048
START_LIMIT_S = 30.0
STOP_LIMIT_S = 10.0
COLLECTIONS_OF_ALL = 1000
"""Collections of the middle generation before one of all; Python's default of 10 is reached once in sixty lists."""
SWITCH_INTERVAL_S = 0.0005
"""Longest time for which a thread keeps the interpreter while others wait for it. An answer waits again after each
statement of the database and each packet, for as long as all threads at work together: 20 ms by Python's 5 ms."""


class PortTaken(VitacError):
    """Another program listens at the address."""


class ServerDidNotStart(VitacError):
    """The HTTP server ended before it was ready; its service events say why."""


def bind(host: str, port: int) -> socket.socket:
    """Return a socket bound to an address; port 0 means any free port.

    Raises:
        PortTaken: the port is in use, or this user may not use it.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    # Accepted connections inherit it. Head and body of an answer are two packets, and with Nagle's algorithm the second
    # waits 40 ms for the client's delayed acknowledgement.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    try:
        listener.bind((host, port))
    except OSError as error:
        listener.close()
        raise PortTaken(
            f"Cannot listen at {host} port {port}: {error.strerror}. Choose another with --port (0 for any free one)."
        ) from error
    return listener


def collect_garbage_rarely() -> None:
    """Take what is loaded by now out of garbage collections, and collect the rest less often.

    Otherwise they stop answers: for 100 ms now and then with what is loaded, and for 20 ms on one page of fifty rows in
    a hundred without it.
    """
    gc.collect()
    gc.freeze()
    young, middle, _ = gc.get_threshold()
    gc.set_threshold(young, middle, COLLECTIONS_OF_ALL)


def allow_many_connections() -> None:
    """Open as many files as the system lets this process: each event stream is a connection and some locked files."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def bind_or_any(host: str, port: int) -> socket.socket:
    """Return a socket bound to the port, or to a free one if it is taken."""
    try:
        return bind(host, port)
    except PortTaken:
        return bind(host, 0)


def format_address(listener: socket.socket) -> str:
    """Return the address to show: `http://127.0.0.1:8000`."""
    host, port = listener.getsockname()[:2]
    shown = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)  # noqa: S104
    return f"http://{shown}:{port}"


@dataclass(kw_only=True)
class WebServer:
    """An application served at a bound socket from `start` to `stop`.

    Attributes:
        app: the application.
        listener: bound socket; closed by `stop`.
        trusted_proxies: addresses or networks whose X-Forwarded-For and X-Forwarded-Proto are accepted.
    """

    app: FastAPI
    listener: socket.socket
    trusted_proxies: Sequence[str] = ()
    _server: uvicorn.Server | None = field(default=None, init=False)
    _thread: threading.Thread | None = field(default=None, init=False)

    def start(self) -> None:
        """Start serving; return when requests are answered.

        Raises:
            ServerDidNotStart: the server ended or was not ready in time.
        """
        import uvicorn

        from .bounded_head import BoundedHeadProtocol

        allow_many_connections()
        configuration = uvicorn.Config(
            self.app,
            http=BoundedHeadProtocol,
            proxy_headers=bool(self.trusted_proxies),
            forwarded_allow_ips=list(self.trusted_proxies),
            log_config=None,
            access_log=False,
            backlog=BACKLOG,
            timeout_graceful_shutdown=3,
            server_header=False,
        )
        self._server = uvicorn.Server(configuration)
        self._thread = threading.Thread(target=self._run, args=[self._server], name="http", daemon=True)
        self._thread.start()
        deadline = time.monotonic() + START_LIMIT_S
        while not self._server.started:
            if not self._thread.is_alive() or time.monotonic() > deadline:
                raise ServerDidNotStart("The HTTP server did not start; `vitac serve` prints why.")
            time.sleep(0.01)
        collect_garbage_rarely()
        sys.setswitchinterval(SWITCH_INTERVAL_S)

    def stop(self) -> None:
        """End all connections and stop serving."""
        if self._server is not None and self._thread is not None:
            self._server.should_exit = True
            self._thread.join(STOP_LIMIT_S)
        self.listener.close()

    def _run(self, server: uvicorn.Server) -> None:
        with suppress(SystemExit):  # how uvicorn reports that the application did not start
            server.run(sockets=[self.listener])


@contextmanager
def no_collections() -> Iterator[None]:
    """Collect no garbage while modules are loaded, and leave what they hold alone afterwards.

    All of it stays until the process ends. Looking through it took a third of the CPU time of loading a worker.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if was_enabled:
            gc.enable()


def configure_events(stream: TextIO, form: LogFormat) -> None:
    """Write the service events of this process (ours and the libraries') to a stream, one line per event."""
    import structlog
    from vitac.server.settings import LogFormat

    first: list[Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    last: list[Processor] = [structlog.processors.format_exc_info]
    if form is LogFormat.JSON:
        last.append(structlog.processors.JSONRenderer(default=str))
    else:
        last.append(structlog.processors.KeyValueRenderer(key_order=["timestamp", "level", "event"]))
    structlog.configure(
        processors=[*first, *last],
        logger_factory=structlog.PrintLoggerFactory(stream),
        cache_logger_on_first_use=False,
    )
    handler = logging.StreamHandler(stream)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=[*first, structlog.stdlib.add_logger_name],
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *last],
        )
    )
    logging.basicConfig(handlers=[handler], level=logging.WARNING, force=True)


def keep_events_off_output() -> None:
    """Write service events to standard error unless `configure_events` was called: standard output is for results."""
    import structlog

    if not structlog.is_configured():
        structlog.configure(logger_factory=lambda *_: structlog.PrintLogger(sys.stderr))
