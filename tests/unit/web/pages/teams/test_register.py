from collections.abc import Iterator
from datetime import UTC, datetime

import pytest
from asgi_browser import AsgiBrowser
from cli_service import CliService, cli_service
from httpx import Client
from page_service import FixedData, an_application
from visits import GELBOTS
from vitac.server.settings import Registration
from vitac.web.session import signer

FOREIGN = {"sec-fetch-site": "cross-site"}


def test_registers_shows_the_token_once_and_signs_in(browser: AsgiBrowser) -> None:
    assert 'action="/register"' in browser.get("/register").text
    answer = browser.post("/register", data={"name": "Newcomers", "contact": ""})
    assert answer.status_code == 201
    assert answer.headers["cache-control"] == "no-store"
    assert "vitac_made" in answer.text
    assert ">Sign in</a>" not in answer.text, "that is done"
    assert signer.COOKIE in browser.cookies
    assert "vitac_made" not in browser.get("/register").text
    assert browser.get("/submissions").status_code == 200


def test_a_name_that_is_taken_can_be_corrected_in_the_form(browser: AsgiBrowser) -> None:
    answer = browser.post("/register", data={"name": "Bears", "contact": '"><script>'})
    assert answer.status_code == 409
    assert "already" in answer.text
    assert 'value="Bears"' in answer.text
    assert "<script>" not in answer.text.replace('<script src="', "")
    assert signer.COOKIE not in browser.cookies
    assert ">Sign in</a>" in answer.text
    browser.post("/register", data={"name": "Newcomers"})
    assert "Sign out" in browser.post("/register", data={"name": "Bears"}).text, "of the team that is signed in"


def browser_where_registration_is(rule: Registration) -> AsgiBrowser:
    return AsgiBrowser(
        an_application(FixedData(visitors=[GELBOTS], settings={"registration": rule, "invite_code": "let me in"}))
    )


def test_an_invite_is_asked_for_where_one_is_needed() -> None:
    assert "Invite code" not in browser_where_registration_is(Registration.OPEN).get("/register").text
    browser = browser_where_registration_is(Registration.INVITE)
    assert "Invite code" in browser.get("/register").text
    assert browser.post("/register", data={"name": "New", "invite": "guess"}).status_code == 403
    assert browser.post("/register", data={"name": "New", "invite": "let me in"}).status_code == 201


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


def test_the_service_registers_a_team_and_bounds_how_often(service: CliService) -> None:
    with Client(base_url=service.address, headers={"accept": "text/html"}, trust_env=False) as client:
        answer = client.post("/register", data={"name": "Newcomers", "contact": "a@example.org"})
        assert answer.status_code == 201, answer.text
        assert client.get("/submissions").status_code == 200
        assert client.post("/register", data={"name": "New\u0000"}).status_code == 422
        assert client.post("/register", data={"name": "Newcomers"}).status_code == 409
        flooded = client.post("/register", data={"name": "Others"})
        assert (flooded.status_code, "wait" in flooded.text) == (429, True)
