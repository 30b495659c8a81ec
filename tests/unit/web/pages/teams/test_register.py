from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from asgi_browser import AsgiBrowser
from cli_service import CliService, cli_service
from page_service import FixedData, an_application
from served_pages import secret_in, visitor
from visits import GELBOTS
from vitac.server.settings import Registration

FOREIGN = {"sec-fetch-site": "cross-site"}


def browser_where_registration_is(rule: Registration) -> AsgiBrowser:
    return AsgiBrowser(
        an_application(FixedData(visitors=[GELBOTS], settings={"registration": rule, "invite_code": "let me in"}))
    )


def test_an_invite_is_asked_for_where_one_is_needed() -> None:
    assert "Invite code" not in browser_where_registration_is(Registration.OPEN).get("/register").text
    browser = browser_where_registration_is(Registration.INVITE)
    assert "Invite code" in browser.get("/register").text
    assert browser.post("/register", data={"name": "New", "invite": "guess"}).status_code == 403


def test_closed_registration_shows_no_form() -> None:
    html = browser_where_registration_is(Registration.CLOSED).get("/register").text
    assert 'action="/register"' not in html
    assert "ask them for a token" in html


@pytest.mark.parametrize("path", ["/", "/sign-in", "/tracks/track_1", "/tracks/track_1/rules"])
def test_no_page_offers_to_register_where_registration_is_closed(path: str) -> None:
    for rule in Registration:
        html, is_open = browser_where_registration_is(rule).get(path).text, rule is not Registration.CLOSED
        assert ('href="/register"' in html) == is_open, rule
        if path.endswith("/rules"):
            assert ("vitac register" in html) == is_open, rule
            assert "vitac login" in html or is_open, rule


def test_after_the_lock_date_no_form_adds_a_team_or_member(data: FixedData, browser: AsgiBrowser) -> None:
    data.locked_since = datetime(2026, 5, 1, 12, tzinfo=UTC)
    for path in ("/register", "/join"):
        html = browser.get(path).text
        assert f'action="{path}"' not in html
        assert "Teams have been locked since" in html
        assert "2026-05-01 12:00 UTC" in html
    data.locked_since = None
    for path in ("/register", "/join"):
        assert f'action="{path}"' in browser.get(path).text


def test_another_site_cannot_register(browser: AsgiBrowser) -> None:
    assert browser.post("/register", data={"name": "Newcomers"}, headers=FOREIGN).status_code == 403


@pytest.fixture
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CliService]:
    with cli_service(tmp_path_factory.mktemp("service") / "state", registrations_per_hour=3) as service:
        yield service


def test_registers_shows_the_token_once_signs_in_and_bounds_how_often(service: CliService) -> None:
    browser = visitor(service)
    assert 'action="/register"' in browser.get("/register").text
    answer = browser.post("/register", data={"name": " Newcomers ", "contact": ""})
    assert (answer.status_code, answer.headers["cache-control"]) == (201, "no-store")
    token = secret_in(answer.text)
    assert visitor(service, token).get("/submissions").status_code == 200
    assert ">Sign in</a>" not in answer.text, "that is done"
    assert token not in browser.get("/register").text
    assert browser.get("/submissions").status_code == 200
    assert browser.post("/register", data={"name": "New\u0000"}).status_code == 422
    stranger = visitor(service)
    taken = stranger.post("/register", data={"name": "Newcomers", "contact": '"><script>'})
    assert (taken.status_code, "already" in taken.text, 'value="Newcomers"' in taken.text) == (409, True, True)
    assert "<script>" not in taken.text.replace('<script src="', "")
    assert ">Sign in</a>" in taken.text
    flooded = browser.post("/register", data={"name": "Others"})
    assert (flooded.status_code, "wait" in flooded.text) == (429, True)
    assert "Sign out" in flooded.text, "of the team that is signed in"


def test_an_invite_registers_where_one_is_needed(tmp_path: Path) -> None:
    rule = {"registration": Registration.INVITE, "invite_code": "let me in"}
    with cli_service(tmp_path / "state", **rule) as service:
        assert visitor(service).post("/register", data={"name": "New", "invite": "let me in"}).status_code == 201
