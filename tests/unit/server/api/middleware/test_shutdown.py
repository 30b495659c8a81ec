import asyncio
import json
from typing import Any

import pytest
from starlette.types import Receive, Scope, Send
from vitac.server.api.middleware.requests import Shutdown

START = {"type": "http.response.start", "status": 200, "headers": []}


def scope(kind: str = "http") -> dict[str, Any]:
    return {"type": kind, "method": "POST", "path": "/x", "query_string": b"", "headers": []}


def messages_of(kind: str = "http", *, begins: bool) -> list[dict[str, Any]]:
    """What is sent when a request is cancelled before or after its answer has begun."""
    sent: list[dict[str, Any]] = []

    async def hang(_: Scope, __: Receive, send: Send) -> None:
        if begins:
            await send(START)
        await asyncio.sleep(60)

    async def send(message: Any) -> None:
        sent.append(message)

    async def receive() -> Any:
        return {"type": "http.disconnect"}

    async def cancelled() -> None:
        request = asyncio.ensure_future(Shutdown(hang)(scope(kind), receive, send))
        await asyncio.sleep(0.01)
        request.cancel("timeout graceful shutdown exceeded")
        await request

    try:
        asyncio.run(cancelled())
    except asyncio.CancelledError:
        sent.append({"type": "cancelled"})
    return sent


def test_a_request_that_is_given_up_is_answered_with_a_problem() -> None:
    start, body = messages_of(begins=False)
    assert start["status"] == 503
    headers = dict(start["headers"])
    assert headers[b"content-type"] == b"application/problem+json"
    assert headers[b"connection"] == b"close"
    assert int(headers[b"retry-after"]) > 0
    problem = json.loads(body["body"])
    assert problem["code"] == "service_stopping"
    assert "send it again" in problem["detail"]


@pytest.mark.parametrize(("kind", "begins"), [("http", True), ("lifespan", False)])
def test_what_has_begun_and_what_is_no_request_stays_cancelled(kind: str, begins: bool) -> None:
    assert messages_of(kind, begins=begins) == [*([START] if begins else []), {"type": "cancelled"}]
