import json
import socket
from typing import Any

from service_client import Service, problem_of

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
