import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import httpx
import pytest
from fastapi import FastAPI
from vitac.cli.service.web_server import PortTaken, ServerDidNotStart, WebServer, address_of, bind, bind_or_any


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
        assert address_of(listener) == f"http://127.0.0.1:{listener.getsockname()[1]}"


def test_serves_from_start_to_stop() -> None:
    app = FastAPI()
    app.add_api_route("/", lambda: "here")
    listener = bind("127.0.0.1", 0)
    address = address_of(listener)
    server = WebServer(app=app, listener=listener)
    server.start()
    assert httpx.get(address).json() == "here"
    server.stop()
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", int(address.rpartition(":")[2]))) != 0


def test_an_application_that_fails_at_its_start_is_told() -> None:
    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        raise RuntimeError("no database")
        yield

    server = WebServer(app=FastAPI(lifespan=lifespan), listener=bind("127.0.0.1", 0))
    with pytest.raises(ServerDidNotStart):
        server.start()
    server.stop()
