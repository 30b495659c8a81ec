import errno
import threading
from uuid import UUID

import httpx
import psycopg
import pytest
from asgi_browser import AsgiBrowser
from page_service import FixedData
from sqlalchemy.exc import OperationalError
from visits import COMPLETED, form_token, sign_in
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.principals import Principal
from vitac.server.views.leaderboards import LeaderboardView
from vitac.web import site
from vitac.web.headers import HEADERS
from vitac.web.pages.submission_detail import SubmissionDetail

SIGN_IN, SIGN_OUT = '<a href="/sign-in">Sign in</a>', 'Sign out <span class="visually-hidden">Gelbots</span>'


def header(answer: httpx.Response) -> list[str]:
    """What the header offers."""
    assert "text/html" in answer.headers["content-type"]
    return [offer for offer in (SIGN_IN, SIGN_OUT) if offer in answer.text]


def test_error_pages_have_the_header_of_other_pages(
    data: FixedData, browser: AsgiBrowser, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(_: object, __: object, submission_id: UUID) -> SubmissionDetail:
        raise ServiceError(ProblemCode.TRACK_REMOVED, f"The track of {submission_id} is gone.")

    def failing() -> list[tuple[int, list[str]]]:
        answers = [browser.get("/nothing-here"), browser.post("/tracks/track_1")]
        answers += [browser.get(f"/submissions/{COMPLETED.id}"), browser.get("/")]
        return [(answer.status_code, header(answer)) for answer in answers]

    monkeypatch.setattr(data, "submission", gone)
    monkeypatch.setattr(data, "board", None)
    assert failing() == [(status, [SIGN_IN]) for status in (404, 405, 410, 500)]
    sign_in(browser, "Gelbots")
    assert failing() == [(status, [SIGN_OUT]) for status in (404, 405, 410, 500)]
    forged = browser.post("/sign-out", data={"form_token": "another"})
    assert (forged.status_code, header(forged)) == (403, [SIGN_OUT])
    assert forged.headers["cache-control"] == "no-store"
    assert form_token(browser) in forged.text, "signing out works from there"


def test_who_cannot_be_looked_up_is_offered_neither_to_sign_in_nor_to_sign_out(
    data: FixedData, browser: AsgiBrowser, monkeypatch: pytest.MonkeyPatch
) -> None:
    sign_in(browser, "Gelbots")
    asked: list[UUID] = []

    def away(token_id: UUID) -> Principal:
        asked.append(token_id)
        raise OperationalError("SELECT 1", {}, psycopg.OperationalError("connection refused"))

    def broken(token_id: UUID) -> Principal:
        raise RuntimeError(f"no idea who {token_id} is")

    monkeypatch.setattr(data, "principal_of_token_id", away)
    answer = browser.get("/")
    assert (answer.status_code, header(answer)) == (503, [])
    assert len(asked) == 1, "a database that failed is not asked again"
    for lookup in (away, broken):
        monkeypatch.setattr(data, "principal_of_token_id", lookup)
        missing = browser.get("/nothing-here")
        assert (missing.status_code, header(missing)) == (404, [])
    browser.cookies.clear()
    assert header(browser.get("/nothing-here")) == [SIGN_IN]


def test_who_asks_too_often_costs_no_look_up_more(
    data: FixedData, browser: AsgiBrowser, monkeypatch: pytest.MonkeyPatch
) -> None:
    sign_in(browser, "Gelbots")
    asked, look_up = [], data.principal_of_token_id

    def counted(token_id: UUID) -> Principal:
        asked.append(token_id)
        return look_up(token_id)

    def refused(_: object, __: object, submission_id: UUID) -> SubmissionDetail:
        raise ServiceError(ProblemCode.TOO_MANY_REQUESTS, f"Wait before you ask for {submission_id} again.")

    monkeypatch.setattr(data, "principal_of_token_id", counted)
    monkeypatch.setattr(data, "submission", refused)
    answer = browser.get(f"/submissions/{COMPLETED.id}")
    assert (answer.status_code, header(answer), len(asked)) == (429, [], 1), "by the page itself"


def test_browsers_get_a_page_and_programs_their_json(browser: AsgiBrowser) -> None:
    page = browser.get("/nothing-here")
    assert page.status_code == 404
    assert "<h1>Page not found</h1>" in page.text
    for path, accepted in (("/nothing-here", "application/json"), ("/api/v1/nothing-here", "text/html")):
        answer = browser.get(path, headers={"accept": accepted})
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["code"] == "not_found"


def test_a_database_that_stands_still_is_a_page_that_says_so(
    data: FixedData, browser: AsgiBrowser, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(site, "PAGE_TIMEOUT_S", 0.05)
    data.leaderboard = lambda *_, **__: threading.Event().wait(0.5)  # type: ignore[assignment,method-assign]
    answer = browser.get("/")
    assert answer.status_code == 503
    assert "The database does not answer" in answer.text


def test_a_crash_is_a_page_that_tells_nothing_of_the_inside(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = None  # type: ignore[assignment]
    answer = browser.get("/")
    assert answer.status_code == 500
    assert "Internal error" in answer.text
    assert "Traceback" not in answer.text
    assert answer.headers["content-security-policy"] == HEADERS["Content-Security-Policy"]


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (psycopg.OperationalError("connection refused"), "The database is starting or unavailable"),
        (psycopg.OperationalError("sorry, too many clients already"), "The database has no free connection"),
        (psycopg.errors.QueryCanceled(), "The database took too long"),
    ],
)
def test_database_that_is_away_is_a_page_that_says_why_and_when_to_come_back(
    data: FixedData, browser: AsgiBrowser, error: Exception, sentence: str
) -> None:
    def away(*_: object, **__: object) -> LeaderboardView:
        raise OperationalError("SELECT 1", {}, error)

    data.leaderboard = away  # type: ignore[assignment]
    answer = browser.get("/")
    assert answer.status_code == 503
    assert answer.headers["retry-after"] == "2"
    assert f"{sentence}; try again in a moment." in answer.text
    program = browser.get("/", headers={"accept": "*/*"})
    assert (program.status_code, program.json()["code"]) == (503, "database_unavailable")


@pytest.mark.parametrize(
    "error",
    [OSError(errno.ENOSPC, "No space left on device"), OperationalError("INSERT", {}, psycopg.errors.DiskFull())],
)
def test_full_disk_is_a_page_that_says_so(data: FixedData, browser: AsgiBrowser, error: Exception) -> None:
    def full(*_: object, **__: object) -> LeaderboardView:
        raise error

    data.leaderboard = full  # type: ignore[assignment]
    answer = browser.get("/")
    assert answer.status_code == 507
    assert "The disk of the service is full" in answer.text


def test_wrong_method_is_a_page(browser: AsgiBrowser) -> None:
    answer = browser.post("/tracks/track_1")
    assert answer.status_code == 405
    assert "GET" in answer.headers["allow"]


def test_words_between_backticks_of_a_message_are_code(
    data: FixedData, browser: AsgiBrowser, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> SubmissionDetail:
        raise ServiceError(ProblemCode.TOO_MANY_REQUESTS, "Use `vitac <status>`.")

    monkeypatch.setattr(data, "submission", refused)
    assert "Use <code>vitac &lt;status&gt;</code>." in browser.get(f"/submissions/{COMPLETED.id}").text
