from datetime import UTC, datetime, timedelta

import pytest
from asgi_browser import AsgiBrowser
from seeded_site import GELBOTS, SeededSite, seeded_site
from served_pages import secret_in
from vitac.server.settings import Registration
from vitac.web import session as signer

from competitions import make_competition, open_now, put_in_place


def test_registers_shows_the_token_once_and_signs_in(site: SeededSite, browser: AsgiBrowser) -> None:
    assert 'action="/register"' in browser.get("/register").text
    answer = browser.post("/register", data={"name": " Newcomers ", "contact": "a@example.org"})
    assert answer.status_code == 201
    assert answer.headers["cache-control"] == "no-store"
    token = secret_in(answer.text)
    assert ">Sign in</a>" not in answer.text, "that is done"
    assert signer.COOKIE in browser.cookies
    assert token not in browser.get("/register").text
    assert site.visitor().post("/sign-in", data={"token": token}).status_code == 303
    assert browser.get("/submissions").status_code == 200


def test_a_name_that_is_taken_can_be_corrected_in_the_form(site: SeededSite, browser: AsgiBrowser) -> None:
    taken = {"name": "Bears", "contact": '"><script>'}
    answer = browser.post("/register", data=taken)
    assert answer.status_code == 409
    assert "already" in answer.text
    assert 'value="Bears"' in answer.text
    assert "<script>" not in answer.text.replace('<script src="', "")
    assert signer.COOKIE not in browser.cookies
    assert ">Sign in</a>" in answer.text
    assert browser.post("/register", data={"name": "New\u0000"}).status_code == 422
    assert "Sign out" in site.visitor(GELBOTS).post("/register", data=taken).text, "of the team that is signed in"


@pytest.mark.parametrize("rule", Registration)
def test_forms_and_links_follow_the_rule_of_registration(rule: Registration) -> None:
    is_open = rule is not Registration.CLOSED
    with seeded_site(registration=rule, invite_code="let me in") as site:
        browser = site.visitor()
        html = browser.get("/register").text
        assert ('action="/register"' in html) == is_open
        assert ("Invite code" in html) == (rule is Registration.INVITE)
        assert ("ask them for a token" in html) == (not is_open)
        for path in ("/", "/sign-in", "/tracks/track_1", "/tracks/track_1/rules"):
            html = browser.get(path).text
            assert ('href="/register"' in html) == is_open, path
        assert ("vitac register" in html) == is_open
        assert "vitac login" in html or is_open
        if rule is Registration.INVITE:
            assert browser.post("/register", data={"name": "New", "invite": "guess"}).status_code == 403
            assert browser.post("/register", data={"name": "New", "invite": "let me in"}).status_code == 201


def test_after_the_lock_date_no_form_adds_a_team_or_member(site: SeededSite, browser: AsgiBrowser) -> None:
    for path in ("/register", "/join"):
        assert f'action="{path}"' in browser.get(path).text
    locked = datetime.now(UTC) - timedelta(hours=1)
    with site.database.transaction() as session:
        put_in_place(session, open_now(make_competition(teams_locked=locked.isoformat())))
    for path in ("/register", "/join"):
        html = browser.get(path).text
        assert f'action="{path}"' not in html
        assert "Teams have been locked since" in html
        assert f"{locked:%F %H:%M} UTC" in html


def test_registrations_of_an_address_are_bounded() -> None:
    with seeded_site(registrations_per_hour=1) as site:
        assert site.visitor().post("/register", data={"name": "First"}).status_code == 201
        flooded = site.visitor().post("/register", data={"name": "Others"})
    assert (flooded.status_code, "wait" in flooded.text) == (429, True)
