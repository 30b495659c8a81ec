import asyncio
import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import httpx
import pytest
import structlog
from fastapi import FastAPI, Request
from service_client import Service, bearer, make_archive, problem_of
from starlette.responses import Response
from starlette.types import Receive, Scope, Send
from vitac.server.api import problems
from vitac.server.api.middleware import requests
from vitac.server.api.middleware.requests import LIMIT_BYTES, RelativeRedirects, RequestIds, Shutdown
from vitac.server.database.metrics import list_samples
from vitac.server.errors import ProblemCode, ServiceError


def test_large_json_is_refused_whether_its_length_is_told_or_not(service: Service) -> None:
    body = b'{"name": "' + b"x" * LIMIT_BYTES + b'"}'

    def chunks() -> Iterator[bytes]:
        yield from (body[start : start + 65536] for start in range(0, len(body), 65536))

    headers = {"Content-Type": "application/json"} | bearer(service.token)
    for content in (body, chunks()):
        problem_of(service.client.post("/api/v1/tokens", content=content, headers=headers), 413, "body_too_large")
    assert service.client.get("/health").status_code == 200


def test_body_at_the_limit_is_read(service: Service) -> None:
    body = b'{"name": "fits"' + b" " * (LIMIT_BYTES - 16) + b"}"
    assert len(body) == LIMIT_BYTES
    answer = service.client.post("/api/v1/teams", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 201


def test_uploads_have_their_own_limit(service: Service) -> None:
    archive = make_archive({"Track_1/weights": os.urandom(2 * LIMIT_BYTES)})
    problem_of(service.upload(archive), 422, "manifest_rejected")


def test_a_body_that_trickles_is_given_up_though_it_never_stops(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(requests, "BODY_TIMEOUT_S", 0.3)
    with socket.create_connection(service.address, timeout=0.02) as connection:
        connection.sendall(b"POST /api/v1/teams HTTP/1.1\r\nHost: a\r\nContent-Length: 60000\r\n\r\n{")
        answer = b""
        for _ in range(1000):
            with suppress(TimeoutError):
                answer += connection.recv(4096)
            if answer:
                break
            with suppress(ConnectionError):  # it has just been given up
                connection.sendall(b" ")
    assert answer.startswith(b"HTTP/1.1 408 ")
    assert b"connection: close" in answer.lower()
    assert service.client.get("/health").status_code == 200


def test_an_answer_may_take_longer_than_the_body(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requests, "BODY_TIMEOUT_S", 0.2)
    submission = service.upload(make_archive()).json()["id"]
    events = []
    with service.client.stream(
        "GET", f"/api/v1/submissions/{submission}/events", headers=bearer(service.token)
    ) as all_:
        for line in all_.iter_lines():
            events.append(line)
            if len(events) == 1:
                time.sleep(0.5)
                service.post(f"/submissions/{submission}/cancel")
    assert "event: end" in events


def test_an_answer_its_problem_and_its_service_events_name_one_request() -> None:
    app = FastAPI()
    app.add_middleware(RequestIds)
    problems.install(app)

    @app.get("/refused")
    def refuse(_: Request) -> Response:
        structlog.get_logger().warning("refused")
        raise ServiceError(ProblemCode.TEAM_EXISTS, "Expected another name.")

    async def ask() -> list[httpx.Response]:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app=app), base_url="http://service") as client:
            return [await client.get("/refused") for _ in range(2)]

    # Not `capture_logs`: it leaves out the processor that adds the id.
    noted: list[str] = []

    def note(_: object, __: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
        noted.append(event["request"])
        raise structlog.DropEvent

    before = structlog.get_config()
    structlog.configure(processors=[structlog.contextvars.merge_contextvars, note], cache_logger_on_first_use=False)
    try:
        answers = asyncio.run(ask())
    finally:
        structlog.configure(**before)
    ids = [answer.headers["x-request-id"] for answer in answers]
    assert ids == [answer.json()["request_id"] for answer in answers] == noted
    assert len(set(ids)) == 2


def test_a_redirect_does_not_follow_the_host_header() -> None:
    app = FastAPI()
    app.add_middleware(RelativeRedirects)
    app.get("/team")(lambda: None)

    async def ask() -> httpx.Response:
        inside = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=inside, base_url="http://elsewhere.example") as client:
            return await client.get("/team/?a=b")

    answer = asyncio.run(ask())
    assert (answer.status_code, answer.headers["location"]) == (307, "/team?a=b")


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


JSON = {"Content-Type": "application/json"}
PATHS = [
    "/submissions?track=%00",
    "/submissions?team=a%00b",
    "/submissions?before=%00",
    "/leaderboards/%00",
    "/leaderboards/track_1?task=%00",
    "/leaderboards/%00/logs",
    "/tracks/track_1%00",
    "/submissions/%00",
]


def test_nul_in_path_or_query_is_refused(service: Service) -> None:
    for path in PATHS:
        for token in (service.token, service.organizer_token):
            problem = problem_of(service.get(path, token), 422, "invalid_request")
            assert "NUL" in problem["detail"]


def test_nul_in_the_query_of_an_upload_is_refused(service: Service) -> None:
    problem_of(service.upload(b"", service.organizer_token, query="?team=%00"), 422, "invalid_request")


BODIES: list[dict[str, Any]] = [
    {"label": "a", "team": "\x00"},
    {"label": "\x00"},
    {"label": "a", "team": "\ud800"},
    {"label": "\ud800"},
    {"label": "a", "\ud800": 1},
    {"label": "a", "\x00": 1},
]


def test_what_is_no_text_in_a_body_is_refused(service: Service) -> None:
    for body in BODIES:
        problem_of(
            service.post("/tokens", service.organizer_token, content=json.dumps(body), headers=JSON),
            422,
            "invalid_request",
        )


def test_what_is_no_text_in_a_team_name_is_refused(service: Service) -> None:
    for name in ["\x00ab", "\ud800ab"]:
        for body in ({"name": name}, {"name": "fine", "contact": name}):
            answer = service.client.post("/api/v1/teams", content=json.dumps(body), headers=JSON)
            problem_of(answer, 422, "invalid_request")


def test_two_lengths_of_one_body_are_refused_and_the_connection_is_closed(service: Service) -> None:
    """What a proxy took for the body must not be read as the next request."""
    head = b"POST /api/v1/teams HTTP/1.1\r\nHost: a\r\nContent-Type: application/json\r\n"
    smuggled = b"GET /health HTTP/1.1\r\nHost: a\r\n\r\n"
    body = b"0\r\n\r\n" + smuggled
    for lengths in (
        b"Content-Length: %d\r\nTransfer-Encoding: chunked\r\n",
        b"Transfer-Encoding: chunked\r\nContent-Length: %d\r\n",
    ):
        with socket.create_connection(service.address, timeout=60) as connection:
            connection.sendall(head + lengths % len(body) + b"\r\n" + body)
            answer = b"".join(iter(lambda: connection.recv(4096), b""))
        assert answer.startswith(b"HTTP/1.1 400")
        assert b'"length_invalid"' in answer
        assert answer.count(b"HTTP/1.1") == 1


def counted(service: Service) -> dict[tuple[str, str, str], float]:
    """Requests by method, route and status."""
    found = {}
    for key, value in list_samples(service.services.instruments).items():
        if key.name == "vitac_request_seconds_count":
            labels = key.label_values()
            found[(labels["method"], labels["route"], labels["status"])] = value
    return found


def test_requests_are_counted_by_the_route_that_answers(service: Service) -> None:
    service.client.get("/health")
    service.get("/submissions/00000000-0000-0000-0000-000000000000")
    service.get("/submissions/00000000-0000-0000-0000-000000000001")
    service.get("/tracks/track_1")
    assert counted(service) == {
        ("GET", "/health", "2xx"): 1,
        ("GET", "/api/v1/submissions/{submission_id}", "4xx"): 2,
        ("GET", "/api/v1/tracks/{track}", "2xx"): 1,
    }


@pytest.mark.parametrize(("method", "path"), [("GET", "/made/up/1"), ("GET", "/made/up/2"), ("INVENT", "/made/up")])
def test_names_that_clients_make_up_are_no_labels(service: Service, method: str, path: str) -> None:
    service.client.request(method, path)
    ((counted_method, route, _),) = counted(service)
    assert route == "unknown"
    assert counted_method == ("GET" if method == "GET" else "unknown")


def test_refusals_of_request_heads_are_counted(service: Service) -> None:
    service.client.get("/health?a=%00")
    assert counted(service) == {("GET", "unknown", "4xx"): 1}
