import os
import socket
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest
from service_client import Service, bearer, make_archive, problem_of
from vitac.server.api.middleware import requests
from vitac.server.api.middleware.requests import LIMIT_BYTES


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
