import errno

import psycopg
import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import FixedData
from sqlalchemy.exc import OperationalError
from vitac.server.views.leaderboards import LeaderboardView
from vitac.web.headers import HEADERS


def test_browsers_get_a_page_and_programs_their_json(browser: AsgiBrowser) -> None:
    page = browser.get("/nothing-here")
    assert page.status_code == 404
    assert "<h1>Page not found</h1>" in page.text
    for path, accepted in (("/nothing-here", "application/json"), ("/api/v1/nothing-here", "text/html")):
        answer = browser.get(path, headers={"accept": accepted})
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["code"] == "not_found"


def test_a_crash_is_a_page_that_tells_nothing_of_the_inside(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = None  # type: ignore[assignment]
    answer = browser.get("/")
    assert answer.status_code == 500
    assert "Internal error" in answer.text
    assert "Traceback" not in answer.text
    assert answer.headers["content-security-policy"] == HEADERS["Content-Security-Policy"]


def test_database_that_is_away_is_a_page_that_says_when_to_come_back(data: FixedData, browser: AsgiBrowser) -> None:
    async def away(track: str, task: str | None, stage: str | None = None) -> LeaderboardView:
        raise OperationalError("SELECT 1", {}, psycopg.OperationalError("connection refused"))

    data.leaderboard = away  # type: ignore[method-assign]
    answer = browser.get("/")
    assert answer.status_code == 503
    assert answer.headers["retry-after"] == "2"
    assert "Nothing is lost" in answer.text
    program = browser.get("/", headers={"accept": "*/*"})
    assert (program.status_code, program.json()["code"]) == (503, "database_unavailable")


@pytest.mark.parametrize(
    "error",
    [OSError(errno.ENOSPC, "No space left on device"), OperationalError("INSERT", {}, psycopg.errors.DiskFull())],
)
def test_full_disk_is_a_page_that_says_so(data: FixedData, browser: AsgiBrowser, error: Exception) -> None:
    async def full(track: str, task: str | None, stage: str | None = None) -> LeaderboardView:
        raise error

    data.leaderboard = full  # type: ignore[method-assign]
    answer = browser.get("/")
    assert answer.status_code == 507
    assert "The disk of the service is full" in answer.text


def test_wrong_method_is_a_page(browser: AsgiBrowser) -> None:
    answer = browser.post("/tracks/track_1")
    assert answer.status_code == 405
    assert "GET" in answer.headers["allow"]
