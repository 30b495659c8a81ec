import asyncio
import gc
import socket
import threading
from collections.abc import AsyncIterator
from contextlib import ExitStack, suppress

import pytest
import service_client
from fastapi import FastAPI, Response
from fastapi.responses import StreamingResponse
from service_client import serving

pytestmark = pytest.mark.usefixtures("without_earlier_garbage")

REQUEST = "GET {} HTTP/1.1\r\nHost: a\r\n\r\n"


@pytest.fixture
def app() -> FastAPI:
    """Answers at `/`, at `/stream` without an end and at `/large` with more than fits between server and client."""
    app = FastAPI()

    @app.get("/")
    def answer() -> str:
        return "here"

    @app.get("/large")
    def large() -> Response:
        return Response(bytes(16 << 20))

    @app.get("/stream")
    def stream() -> StreamingResponse:
        async def endless() -> AsyncIterator[bytes]:
            yield b"first"
            await asyncio.Event().wait()

        return StreamingResponse(endless())

    return app


def read_until(connection: socket.socket, end: bytes) -> None:
    """Read an answer up to these bytes; with none of them up to its end."""
    read = b""
    while not end or end not in read:
        more = connection.recv(1 << 16)
        if not more:
            assert not end, read
            return
        read += more


def test_a_server_that_has_ended_has_closed_its_connections(app: FastAPI) -> None:
    with ExitStack() as stack:
        with serving(app) as address:
            connect = [stack.enter_context(socket.create_connection(address, timeout=60)) for _ in range(5)]
            silent, unfinished, answered, streamed, gone = connect
            unfinished.sendall(b"GET / HT")
            answered.sendall(REQUEST.format("/").encode())
            read_until(answered, b'"here"')
            for one in (streamed, gone):
                one.sendall(REQUEST.format("/stream").encode())
                read_until(one, b"first")
            gone.close()
            streamed.shutdown(socket.SHUT_WR)
        for one in (silent, unfinished, answered):
            read_until(one, b"")
    gc.collect()  # an open connection would be found here, and make this test fail


@pytest.mark.parametrize(("path", "first"), [("/stream", b"first"), ("/large", b"HTTP/1.1")])
def test_a_request_that_never_ends_is_reported_and_ended(
    app: FastAPI, monkeypatch: pytest.MonkeyPatch, path: str, first: bytes
) -> None:
    monkeypatch.setattr(service_client, "ANSWER_LIMIT_S", 0.05)
    reported: list[type[BaseException]] = []
    monkeypatch.setattr(threading, "excepthook", lambda found: reported.append(found.exc_type))
    with ExitStack() as stack:
        with serving(app) as address:
            reader = stack.enter_context(socket.create_connection(address, timeout=60))
            reader.sendall(REQUEST.format(path).encode())
            read_until(reader, first)
        with suppress(ConnectionError):
            read_until(reader, b"")
    assert reported == [TimeoutError]
    gc.collect()
