import gc
import socket
import sys
import threading
import time
from asyncio import base_events
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from typing import Any

import httpx
import pytest
from fastapi import FastAPI, Request
from vitac.cli.service import bounded_head
from vitac.cli.service.web_server import (
    COLLECTIONS_OF_ALL,
    SWITCH_INTERVAL_S,
    PortTaken,
    ServerDidNotStart,
    WebServer,
    bind,
    bind_or_any,
    collect_garbage_rarely,
    format_address,
)


@pytest.fixture(autouse=True)
def collections_and_switches_as_before() -> Iterator[None]:
    """Servers make collections rare, and what other tests leave open would be found at no certain time."""
    before, switch_s = gc.get_threshold(), sys.getswitchinterval()
    yield
    gc.set_threshold(*before)
    sys.setswitchinterval(switch_s)


def test_a_taken_port_is_refused_with_the_way_out() -> None:
    with bind("127.0.0.1", 0) as taken:
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(PortTaken, match=rf"port {port}: Address already in use.*--port"):
            bind("127.0.0.1", port)


def test_another_port_is_taken_where_any_will_do() -> None:
    with bind("127.0.0.1", 0) as taken:
        taken.listen()
        with bind_or_any("127.0.0.1", taken.getsockname()[1]) as other:
            assert other.getsockname()[1] not in {0, taken.getsockname()[1]}


def test_address_is_one_that_a_browser_can_open() -> None:
    with bind("0.0.0.0", 0) as listener:  # noqa: S104 - all addresses is the case
        assert format_address(listener) == f"http://127.0.0.1:{listener.getsockname()[1]}"


def test_serves_from_start_to_stop() -> None:
    app = FastAPI()
    app.add_api_route("/", lambda: "here")
    listener = bind("127.0.0.1", 0)
    address = format_address(listener)
    server = WebServer(app=app, listener=listener)
    server.start()
    assert httpx.get(address, timeout=60).json() == "here"
    assert sys.getswitchinterval() == pytest.approx(SWITCH_INTERVAL_S)
    server.stop()
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", int(address.rpartition(":")[2]))) != 0


@contextmanager
def serving(app: FastAPI, **options: Any) -> Iterator[tuple[str, int]]:
    listener = bind("127.0.0.1", 0)
    address = listener.getsockname()
    server = WebServer(app=app, listener=listener, **options)
    server.start()
    try:
        yield address
    finally:
        server.stop()


def test_answers_do_not_wait_for_acknowledgements() -> None:
    """With Nagle's algorithm every small answer took 44 ms."""
    with bind("127.0.0.1", 0) as listener:
        listener.listen()
        with socket.create_connection(listener.getsockname()), listener.accept()[0] as accepted:
            assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


@pytest.mark.parametrize(
    ("trusted", "seen"), [((), "127.0.0.1"), (("10.0.0.0/8",), "127.0.0.1"), (("127.0.0.0/8",), "192.0.2.7")]
)
def test_a_forwarded_address_counts_from_trusted_proxies_only(trusted: tuple[str, ...], seen: str) -> None:
    app = FastAPI()

    @app.get("/")
    def address(request: Request) -> str:
        return request.client.host if request.client is not None else "none"

    with serving(app, trusted_proxies=trusted) as (host, port):
        answer = httpx.get(f"http://{host}:{port}/", headers={"X-Forwarded-For": "198.51.100.1, 192.0.2.7"}, timeout=60)
    assert answer.json() == seen


def echo() -> FastAPI:
    app = FastAPI()

    @app.post("/")
    async def size(request: Request) -> int:
        return len(await request.body())

    return app


def test_a_client_that_does_not_finish_its_headers_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounded_head, "HEAD_TIMEOUT_S", 0.3)
    with serving(echo()) as address:
        for first in (b"", b"POST / HTTP/1.1\r\nHost: a\r\n", FULL_REQUEST + b"POST / HTTP/1.1\r\n"):
            with socket.create_connection(address, timeout=60) as connection:
                connection.sendall(first)
                assert trickle_until_closed(connection)


FULL_REQUEST = b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 2\r\n\r\nab"


def trickle_until_closed(connection: socket.socket) -> bool:
    """Send a byte of a header now and then; return whether the server has closed the connection meanwhile."""
    connection.settimeout(0.05)
    for _ in range(400):
        try:
            if not connection.recv(4096):
                return True
            continue
        except TimeoutError:
            pass
        except ConnectionError:
            return True
        with suppress(ConnectionError):
            connection.sendall(b"a")
    return False


def test_a_slow_body_is_not_taken_for_a_slow_head(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(base_events, "time", clock)
    app, has_begun = echo(), threading.Event()

    @app.post("/slow")
    async def slow(request: Request) -> int:
        has_begun.set()
        return len(await request.body())

    with serving(app) as (host, port), socket.create_connection((host, port), timeout=60) as connection:
        connection.sendall(FULL_REQUEST.replace(b"/", b"/slow", 1)[:-1])
        assert has_begun.wait(60)
        clock.passed_s = 2 * bounded_head.HEAD_TIMEOUT_S
        assert httpx.post(f"http://{host}:{port}", content=b"ab", timeout=60).json() == 2  # what was due has been done
        connection.sendall(FULL_REQUEST[-1:])
        assert connection.recv(4096).startswith(b"HTTP/1.1 200 OK")


class Clock:
    """The clock of event loops; a test lets time pass on it."""

    def __init__(self) -> None:
        self.passed_s = 0.0

    def monotonic(self) -> float:
        return time.monotonic() + self.passed_s

    def __getattr__(self, name: str) -> Any:
        return getattr(time, name)


def test_an_application_that_fails_at_its_start_is_told() -> None:
    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        raise RuntimeError("no database")
        yield

    server = WebServer(app=FastAPI(lifespan=lifespan), listener=bind("127.0.0.1", 0))
    with pytest.raises(ServerDidNotStart):
        server.start()
    server.stop()


def test_collections_of_all_objects_become_rare_and_spare_what_is_loaded() -> None:
    n_frozen = gc.get_freeze_count()
    gc.set_threshold(600, 11, 12)
    collect_garbage_rarely()
    assert gc.get_freeze_count() > n_frozen
    assert gc.get_threshold() == (600, 11, COLLECTIONS_OF_ALL)
