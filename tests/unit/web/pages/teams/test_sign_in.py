from datetime import UTC, datetime, timedelta

import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import an_id
from page_service import SIGNER, FixedData, an_application
from visits import GELBOTS, RUNNING, form_token, sign_in
from vitac.web.session import signer


def test_sign_in_sets_a_cookie_that_scripts_and_other_sites_do_not_get(browser: AsgiBrowser) -> None:
    answer = browser.post("/sign-in", data={"token": " token-of-Gelbots\n"})
    cookie = answer.headers["set-cookie"]
    assert answer.headers["location"] == "/submissions"
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    assert "token-of-Gelbots" not in cookie
    assert "Secure" not in cookie


def test_cookie_is_secure_over_https(data: FixedData) -> None:
    browser = AsgiBrowser(an_application(data), base_url="https://arena.test")
    assert "Secure" in browser.post("/sign-in", data={"token": "token-of-Gelbots"}).headers["set-cookie"]


def test_wrong_token_is_told_beside_the_field(browser: AsgiBrowser) -> None:
    answer = browser.post("/sign-in", data={"token": "vitac_wrong"})
    assert answer.status_code == 401
    assert 'aria-invalid="true"' in answer.text
    assert "unknown, revoked or expired" in answer.text
    assert "vitac_wrong" not in answer.text
    assert signer.COOKIE not in browser.cookies


def test_wrong_token_ends_no_session(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    for path, given in (("/sign-in", {"token": "wrong"}), ("/sign-in/password", {"password": "wrong"})):
        answer = browser.post(path, data=given)
        assert answer.status_code == 401
        assert 'Sign out <span class="visually-hidden">Gelbots' in answer.text
        assert answer.headers["cache-control"] == "no-store"


@pytest.mark.parametrize(
    "target", ["https://evil.test/", "//evil.test", "/\\evil.test", "javascript:alert(1)", "", "x"]
)
def test_sign_in_leads_to_no_other_site(browser: AsgiBrowser, target: str) -> None:
    answer = browser.post("/sign-in", data={"token": "token-of-Gelbots", "next": target})
    assert answer.headers["location"] == "/submissions"


def test_sign_in_leads_back_to_where_one_came_from(browser: AsgiBrowser) -> None:
    wanted = f"/submissions/{RUNNING.id}"
    to_sign_in = browser.get(wanted)
    assert to_sign_in.status_code == 303
    assert to_sign_in.headers["location"] == f"/sign-in?next={wanted}"
    assert f'value="{wanted}"' in browser.get(to_sign_in.headers["location"]).text
    assert browser.post("/sign-in", data={"token": "token-of-Gelbots", "next": wanted}).headers["location"] == wanted


def test_revoked_token_ends_its_session(data: FixedData, browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    assert browser.get("/submissions").status_code == 200
    data.visitors.remove(GELBOTS)
    assert browser.get("/submissions").status_code == 303


def test_expired_session_is_none(browser: AsgiBrowser) -> None:
    long_ago = datetime.now(UTC) - signer.LIFETIME - timedelta(seconds=5)
    browser.cookies.set(signer.COOKIE, SIGNER.sign(signer.begin(an_id("t:Gelbots"), now=long_ago)))
    assert browser.get("/submissions").status_code == 303


def test_sign_out_ends_the_session(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    answer = browser.post("/sign-out", data={"form_token": form_token(browser)})
    assert answer.status_code == 303
    assert signer.COOKIE not in browser.cookies


def test_a_member_signs_in_with_a_password_and_out_again(data: FixedData, browser: AsgiBrowser) -> None:
    given = {"team": "Gelbots", "member": "Ann", "password": "password-of-Ann", "next": "/team"}
    wrong = browser.post("/sign-in/password", data=given | {"password": "guess"})
    assert wrong.status_code == 401
    assert 'value="Ann"' in wrong.text
    assert "guess" not in wrong.text
    answer = browser.post("/sign-in/password", data=given)
    assert (answer.status_code, answer.headers["location"]) == (303, "/team")
    browser.post("/sign-out", data={"form_token": form_token(browser)})
    assert data.ended == [GELBOTS.token_id]


def test_too_many_attempts_are_refused_in_the_form() -> None:
    browser = AsgiBrowser(an_application(FixedData(settings={"sign_ins_per_hour": 3})))
    for _ in range(4):
        answer = browser.post("/sign-in/password", data={"team": "Gelbots", "member": "Ann", "password": "guess"})
    assert answer.status_code == 429
    assert 'role="alert"' in answer.text
