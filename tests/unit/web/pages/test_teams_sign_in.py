from datetime import UTC, datetime, timedelta

from asgi_browser import AsgiBrowser
from seeded_site import GELBOTS, SIGNER, SeededSite, form_token, seeded_site
from sqlalchemy import update
from vitac.server.accounts import members, teams
from vitac.server.accounts.members import JoiningMember
from vitac.server.database.models import ApiToken
from vitac.server.principals import CONSOLE
from vitac.web import session as signer

PASSWORD = "a long enough password of Ann"  # noqa: S105 - made up


def sign_in(site: SeededSite, browser: AsgiBrowser, **fields: str) -> str:
    """Signs in with a token; returns where that leads."""
    return browser.post("/sign-in", data={"token": site.token_of(GELBOTS)} | fields).headers["location"]


def test_sign_in_sets_a_cookie_that_scripts_and_other_sites_do_not_get(site: SeededSite) -> None:
    for address, is_secure in (("http://testserver", False), ("https://arena.test", True)):
        answer = site.visitor(base_url=address).post("/sign-in", data={"token": f" {site.token_of(GELBOTS)}\n"})
        cookie = answer.headers["set-cookie"]
        assert answer.headers["location"] == "/submissions"
        assert "HttpOnly" in cookie
        assert "SameSite=strict" in cookie
        assert site.token_of(GELBOTS) not in cookie
        assert ("Secure" in cookie) is is_secure


def test_wrong_token_is_told_beside_the_field(browser: AsgiBrowser) -> None:
    answer = browser.post("/sign-in", data={"token": "vitac_wrong"})
    assert answer.status_code == 401
    assert 'aria-invalid="true"' in answer.text
    assert "unknown, revoked or expired" in answer.text
    assert "vitac_wrong" not in answer.text
    assert signer.COOKIE not in browser.cookies


def test_wrong_token_ends_no_session(site: SeededSite) -> None:
    browser = site.visitor(GELBOTS)
    for path, given in (("/sign-in", {"token": "wrong"}), ("/sign-in/password", {"password": "wrong"})):
        answer = browser.post(path, data=given)
        assert answer.status_code == 401
        assert 'Sign out <span class="visually-hidden">Gelbots' in answer.text
        assert answer.headers["cache-control"] == "no-store"


def test_sign_in_leads_back_to_where_one_came_from_and_to_no_other_site(site: SeededSite, browser: AsgiBrowser) -> None:
    wanted = site.path_of("runs")
    to_sign_in = browser.get(wanted)
    assert to_sign_in.status_code == 303
    assert to_sign_in.headers["location"] == f"/sign-in?next={wanted}"
    assert f'value="{wanted}"' in browser.get(to_sign_in.headers["location"]).text
    assert sign_in(site, browser, next=wanted) == wanted
    for target in ("https://evil.test/", "//evil.test", "/\\evil.test", "javascript:alert(1)", "", "x"):
        assert sign_in(site, site.visitor(), next=target) == "/submissions", target


def test_revoked_token_ends_its_session(site: SeededSite) -> None:
    browser = site.visitor(GELBOTS)
    assert browser.get("/submissions").status_code == 200
    with site.database.transaction() as session:
        session.execute(update(ApiToken).values(revoked_at=datetime.now(UTC)))
    assert browser.get("/submissions").status_code == 303


def test_expired_session_is_none(site: SeededSite, browser: AsgiBrowser) -> None:
    token_id = site.seed.people[GELBOTS].token_id
    assert token_id is not None
    long_ago = datetime.now(UTC) - signer.LIFETIME - timedelta(seconds=5)
    browser.cookies.set(signer.COOKIE, SIGNER.sign(signer.begin(token_id, now=long_ago)))
    assert browser.get("/submissions").status_code == 303


def test_a_member_signs_in_with_a_password_and_out_again(site: SeededSite, browser: AsgiBrowser) -> None:
    with site.database.transaction() as session:
        team = teams.own(session, site.seed.people[GELBOTS])
        _, code = members.invite(session, CONSOLE, team)
        member, _ = members.join(session, JoiningMember(code=code, name="Ann"), timedelta(days=1))
    members.set_password(site.database, CONSOLE, team.id, member.id, PASSWORD, old="")
    given = {"team": GELBOTS, "member": "Ann", "password": PASSWORD, "next": "/team"}
    wrong = browser.post("/sign-in/password", data=given | {"password": "guess"})
    assert wrong.status_code == 401
    assert 'value="Ann"' in wrong.text
    assert "guess" not in wrong.text
    answer = browser.post("/sign-in/password", data=given)
    assert (answer.status_code, answer.headers["location"]) == (303, "/team")
    cookie = browser.cookies[signer.COOKIE]
    assert browser.post("/sign-out", data={"form_token": form_token(browser)}).status_code == 303
    assert signer.COOKIE not in browser.cookies
    browser.cookies.set(signer.COOKIE, cookie)
    assert browser.get("/submissions").status_code == 303, "the session has ended, not its cookie alone"


def test_too_many_attempts_are_refused_in_the_form() -> None:
    with seeded_site(sign_ins_per_hour=3) as site:
        browser = site.visitor()
        for _ in range(4):
            answer = browser.post("/sign-in/password", data={"team": GELBOTS, "member": "Ann", "password": "guess"})
    assert answer.status_code == 429
    assert 'role="alert"' in answer.text
