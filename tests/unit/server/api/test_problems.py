"""Every error becomes problem JSON with a stable code, on an application of a few routes without a database."""

import asyncio
import errno
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import httpx
import pytest
from fastapi import FastAPI, Query
from sqlalchemy.exc import OperationalError
from starlette.exceptions import HTTPException
from vitac.evaluator.tracks import UnknownTask, UnknownTrack
from vitac.server.api import problems
from vitac.server.errors import STATUS_OF_CODE, ProblemCode, ServiceError

TO_RAISE: dict[str, Exception] = {
    "refusal": ServiceError(ProblemCode.TEAM_EXISTS, "Expected another name.", nearest="Touch2"),
    "signed-out": ServiceError(ProblemCode.MISSING_CREDENTIALS, "Expected a token."),
    "busy": ServiceError(ProblemCode.TOO_MANY_REQUESTS, "Wait.", retry_after_s=17),
    "away": ServiceError(ProblemCode.STORAGE_UNAVAILABLE, "The store is away."),
    "full": OSError(errno.ENOSPC, "No space left on device"),
    "quota": OSError(errno.EDQUOT, "Disk quota exceeded"),
    "unreadable": OSError(errno.EIO, "Input/output error at /secret/path"),
    "bug": ValueError("the secret of the service"),
    "teapot": HTTPException(418, "short and stout", headers={"X-Pot": "tea"}),
    "large": HTTPException(413, "Expected at most 5 bytes."),
    "removed-track": UnknownTrack("There is no track 'gone'."),
    "removed-task": UnknownTask("Track 'pegs' has no task 'gone'."),
    "connection": OperationalError("SELECT 1", {}, Exception("gone"), connection_invalidated=True),
    "connections": OperationalError("SELECT 1", {}, Exception("FATAL:  sorry, too many clients already"), False, True),
}


class Client:
    """Asks the application without a network."""

    def __init__(self, app: FastAPI) -> None:
        self.app = app

    def request(self, method: str, path: str, **options: Any) -> httpx.Response:
        async def ask() -> httpx.Response:
            transport = httpx.ASGITransport(app=self.app, raise_app_exceptions=False)
            async with httpx.AsyncClient(transport=transport, base_url="http://service") as client:
                return await client.request(method, path, **options)

        return asyncio.run(ask())

    def get(self, path: str) -> httpx.Response:
        return self.request("GET", path)


@pytest.fixture
def client(tmp_path: Path) -> Client:
    app = FastAPI()
    app.state.settings = SimpleNamespace(database_url="postgresql://elsewhere", state_dir=tmp_path)
    problems.install(app)

    @app.get("/raise/{name}")
    def fail(name: str) -> None:
        raise TO_RAISE[name]

    @app.get("/number")
    def number(value: Annotated[int, Query(ge=1)], word: str) -> int:
        return value + len(word)

    @app.post("/api/v1/submissions")
    @app.patch("/api/v1/uploads/7")
    @app.post("/api/v1/teams")
    def refuse() -> None:
        raise TO_RAISE["refusal"]

    return Client(app)


def problem_of(answer: httpx.Response) -> dict[str, Any]:
    content = answer.json()
    assert isinstance(content, dict)
    assert answer.headers["content-type"] == "application/problem+json"
    assert content["status"] == answer.status_code
    assert content["type"] == f"urn:vitac:problem:{content['code']}"
    assert content["instance"] == answer.request.url.path
    return content


@pytest.mark.parametrize(("name", "gone"), [("removed-track", "no track 'gone'"), ("removed-task", "no task 'gone'")])
def test_what_belongs_to_a_removed_track_is_said_to_be_gone(client: Client, name: str, gone: str) -> None:
    answer = client.get(f"/raise/{name}")
    assert (answer.status_code, answer.json()["code"]) == (410, "track_removed")
    assert answer.json()["detail"].startswith("This belongs to a track or task that this service no longer has. ")
    assert gone in answer.json()["detail"]


def test_every_code_has_a_status_that_says_no() -> None:
    assert set(STATUS_OF_CODE) == set(ProblemCode)
    assert all(status >= 400 for status in STATUS_OF_CODE.values())


def test_a_refusal_has_its_code_sentence_and_extras(client: Client) -> None:
    answer = client.get("/raise/refusal")
    assert problem_of(answer) == {
        "type": "urn:vitac:problem:team_exists",
        "title": "Conflict",
        "status": 409,
        "detail": "Expected another name.",
        "code": "team_exists",
        "instance": "/raise/refusal",
        "nearest": "Touch2",
    }
    assert not {"retry-after", "www-authenticate", "connection"} & set(answer.headers)


@pytest.mark.parametrize(
    ("name", "status", "header", "value"),
    [
        ("signed-out", 401, "www-authenticate", "Bearer"),
        ("busy", 429, "retry-after", "17"),
        ("away", 503, "retry-after", "2"),
        ("teapot", 418, "x-pot", "tea"),
        ("large", 413, "connection", "close"),
    ],
)
def test_headers_say_what_to_do(client: Client, name: str, status: int, header: str, value: str) -> None:
    answer = client.get(f"/raise/{name}")
    problem_of(answer)
    assert (answer.status_code, answer.headers[header]) == (status, value)


def test_what_is_wrong_with_a_request_is_named_with_its_place(client: Client) -> None:
    content = problem_of(client.get("/number?value=0"))
    assert (content["status"], content["code"]) == (422, "invalid_request")
    assert [error["place"] for error in content["errors"]] == ["query.value", "query.word"]
    assert content["detail"].startswith("query.value: ")


def test_an_unknown_path_names_where_the_api_is(client: Client) -> None:
    content = problem_of(client.get("/api/v2/teams"))
    assert (content["status"], content["code"]) == (404, "not_found")
    assert "/openapi.json lists it" in content["detail"]


def test_another_method_names_those_that_are_possible(client: Client) -> None:
    answer = client.request("DELETE", "/number")
    content = problem_of(answer)
    assert (content["status"], content["code"]) == (405, "method_not_allowed")
    assert content["detail"] == "DELETE is not possible at /number; allowed: GET."
    assert answer.headers["allow"] == "GET"


def test_title_and_status_of_a_problem_are_those_of_the_answer(client: Client) -> None:
    content = problem_of(client.get("/raise/teapot"))
    assert (content["title"], content["detail"]) == ("I'm a Teapot", "short and stout")


@pytest.mark.parametrize("name", ["full", "quota"])
def test_a_full_disk_is_told_from_other_failures(client: Client, name: str) -> None:
    content = problem_of(client.get(f"/raise/{name}"))
    assert (content["status"], content["code"]) == (507, "storage_full")


def test_a_database_without_a_free_connection_is_told_from_one_that_is_away(client: Client) -> None:
    content = problem_of(client.get("/raise/connections"))
    assert (content["status"], content["code"]) == (503, "database_unavailable")
    assert content["detail"] == "The database has no free connection; try again in a moment."


def test_a_lost_database_of_our_own_on_a_full_disk_is_a_full_disk(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(problems, "has_space", lambda _: False)
    assert problem_of(client.get("/raise/connection"))["code"] == "database_unavailable"
    client.app.state.settings.database_url = None
    assert problem_of(client.get("/raise/connection"))["code"] == "storage_full"


@pytest.mark.parametrize("name", ["bug", "unreadable"])
def test_a_mistake_of_ours_tells_nothing_of_its_cause(client: Client, name: str) -> None:
    answer = client.get(f"/raise/{name}")
    content = problem_of(answer)
    assert (content["status"], content["code"]) == (500, "internal_error")
    assert "secret" not in answer.text


@pytest.mark.parametrize(
    ("method", "path", "closes"),
    [("POST", "/api/v1/submissions", True), ("PATCH", "/api/v1/uploads/7", True), ("POST", "/api/v1/teams", False)],
)
def test_a_connection_with_an_unread_upload_is_closed(client: Client, method: str, path: str, closes: bool) -> None:
    answer = client.request(method, path, content=b"x")
    problem_of(answer)
    assert (answer.headers.get("connection") == "close") is closes
