import errno
import time
from collections.abc import Callable

import httpx
import psycopg
import pytest
from asgi_browser import AsgiBrowser
from seeded_site import GELBOTS, SeededSite, form_token
from service_factories import forget_boards
from sqlalchemy import event, update
from sqlalchemy.exc import OperationalError
from vitac.server.database.models import Submission
from vitac.server.errors import ProblemCode, ServiceError
from vitac.web import site as site_module
from vitac.web.headers import HEADERS

SIGN_IN, SIGN_OUT = '<a href="/sign-in">Sign in</a>', 'Sign out <span class="visually-hidden">Gelbots</span>'
AWAY = OperationalError("SELECT 1", {}, psycopg.OperationalError("connection refused"))


def header(answer: httpx.Response) -> list[str]:
    """What the header offers."""
    assert "text/html" in answer.headers["content-type"]
    return [offer for offer in (SIGN_IN, SIGN_OUT) if offer in answer.text]


def before_statements(site: SeededSite, table: str, work: Callable[[], None]) -> None:
    """Do something before each statement about a table, such as fail."""
    site.is_changed = True  # its database is of no more use to others
    forget_boards()

    def listener(_: object, __: object, statement: str, *___: object) -> None:
        if table in statement:
            work()

    event.listen(site.database.engine, "before_cursor_execute", listener)


def fail(site: SeededSite, error: Exception, table: str = "evaluations") -> None:
    def raise_error() -> None:
        raise error

    before_statements(site, table, raise_error)


def test_error_pages_have_the_header_of_other_pages(site: SeededSite) -> None:
    visitor, team = site.visitor(), site.visitor(GELBOTS)
    with site.database.transaction() as session:
        session.execute(update(Submission).values(track="chess"))
    removed = [browser.get(site.path_of("done")) for browser in (visitor, team)]
    assert [answer.status_code for answer in removed] == [303, 410]
    assert header(removed[1]) == [SIGN_OUT]
    fail(site, RuntimeError("broken"), "board_results")
    for browser, offer in ((visitor, SIGN_IN), (team, SIGN_OUT)):
        answers = [browser.get("/nothing-here"), browser.post("/tracks/track_1"), browser.get("/tracks/track_1")]
        assert [(answer.status_code, header(answer)) for answer in answers] == [
            (status, [offer]) for status in (404, 405, 500)
        ]
    forged = team.post("/sign-out", data={"form_token": "another"})
    assert (forged.status_code, header(forged)) == (403, [SIGN_OUT])
    assert forged.headers["cache-control"] == "no-store"
    assert form_token(team) in forged.text, "signing out works from there"


@pytest.mark.parametrize("error", [AWAY, RuntimeError("no idea who that is")])
def test_who_cannot_be_looked_up_is_offered_neither_to_sign_in_nor_to_sign_out(
    site: SeededSite, error: Exception
) -> None:
    browser, asked = site.visitor(GELBOTS), []
    before_statements(site, "api_tokens", lambda: asked.append(1))
    fail(site, error, "api_tokens")
    answer = browser.get("/")
    assert (answer.status_code, header(answer), len(asked)) == ((503, [], 1) if error is AWAY else (500, [], 2)), (
        "a database that failed is not asked again"
    )
    missing = browser.get("/nothing-here")
    assert (missing.status_code, header(missing)) == (404, [])
    browser.cookies.clear()
    assert header(browser.get("/nothing-here")) == [SIGN_IN]


def test_who_asks_too_often_costs_no_look_up_more(site: SeededSite) -> None:
    browser, asked = site.visitor(GELBOTS), []
    before_statements(site, "api_tokens", lambda: asked.append(1))
    fail(site, ServiceError(ProblemCode.TOO_MANY_REQUESTS, "Wait, then use `vitac <status>`."))
    answer = browser.get(site.path_of("done"))
    assert (answer.status_code, header(answer), len(asked)) == (429, [], 1), "by the page itself"
    assert "use <code>vitac &lt;status&gt;</code>." in answer.text


def test_browsers_get_a_page_and_programs_their_json(browser: AsgiBrowser) -> None:
    page, wrong_method = browser.get("/nothing-here"), browser.post("/tracks/track_1")
    assert (page.status_code, "<h1>Page not found</h1>" in page.text) == (404, True)
    assert (wrong_method.status_code, "GET" in wrong_method.headers["allow"]) == (405, True)
    for path, accepted in (("/nothing-here", "application/json"), ("/api/v1/nothing-here", "text/html")):
        answer = browser.get(path, headers={"accept": accepted})
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["code"] == "not_found"


def test_a_database_that_stands_still_is_a_page_that_says_so(site: SeededSite, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(site_module, "PAGE_TIMEOUT_S", 0.05)
    pauses_s = iter([0.3])
    before_statements(site, "evaluations", lambda: time.sleep(next(pauses_s, 0.0)))
    answer = site.visitor().get("/")
    assert answer.status_code == 503
    assert "The database does not answer" in answer.text


def test_a_crash_is_a_page_that_tells_nothing_of_the_inside(site: SeededSite) -> None:
    fail(site, RuntimeError("the inside"))
    answer = site.visitor().get("/")
    assert answer.status_code == 500
    assert "Internal error" in answer.text
    assert "Traceback" not in answer.text
    assert "the inside" not in answer.text
    assert answer.headers["content-security-policy"] == HEADERS["Content-Security-Policy"]


@pytest.mark.parametrize(
    ("error", "status", "sentence"),
    [
        (AWAY, 503, "The database is starting or unavailable; try again in a moment."),
        (
            OperationalError("SELECT 1", {}, psycopg.OperationalError("sorry, too many clients already")),
            503,
            "The database has no free connection; try again in a moment.",
        ),
        (
            OperationalError("SELECT 1", {}, psycopg.errors.QueryCanceled()),
            503,
            "The database took too long; try again in a moment.",
        ),
        (OperationalError("INSERT", {}, psycopg.errors.DiskFull()), 507, "The disk of the service is full"),
        (OSError(errno.ENOSPC, "No space left on device"), 507, "The disk of the service is full"),
    ],
)
def test_a_database_that_is_away_or_full_is_a_page_that_says_why_and_when_to_come_back(
    site: SeededSite, error: Exception, status: int, sentence: str
) -> None:
    fail(site, error)
    answer = site.visitor().get("/")
    assert answer.status_code == status
    assert sentence in answer.text
    if status == 503:
        assert answer.headers["retry-after"] == "2"
        program = site.visitor().get("/", headers={"accept": "*/*"})
        assert (program.status_code, program.json()["code"]) == (503, "database_unavailable")
