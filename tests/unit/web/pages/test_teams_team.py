import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import pytest
from argon2 import PasswordHasher
from cli_service import CliService, cli_service
from httpx import Cookies
from served_pages import FORM_TOKEN, PageVisitor, secret_in, team_visitor, visitor, visitor_of_role
from vitac.server.accounts import passwords, teams
from vitac.server.database.states import NoticeKind, Role

from competitions import make_competition, put_in_place

PASSWORD = "correct horse battery"  # noqa: S105 - made up


@pytest.fixture(autouse=True)
def quick_hashes(monkeypatch: pytest.MonkeyPatch) -> None:
    quick = PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)
    monkeypatch.setattr(passwords, "_HASHER", quick)
    monkeypatch.setattr(passwords, "_NOBODYS_HASH", quick.hash("nobody"))


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CliService]:
    with cli_service(tmp_path_factory.mktemp("service") / "state", sign_ins_per_hour=24) as service:
        yield service


def id_beside(page: str, action: str) -> str:
    found = re.search(rf'action="/team/{action}">.*?name="id" value="([0-9a-f-]+)"', page, re.DOTALL)
    assert found is not None, page
    return found[1]


def sign_in(service: CliService, password: str, name: str = "Ann") -> tuple[int, PageVisitor]:
    browser = visitor(service)
    given = {"team": "Team A", "member": name, "password": password}
    return browser.post("/sign-in/password", data=given).status_code, browser


def test_a_member_is_invited_joins_signs_in_leads_and_leaves(service: CliService) -> None:
    captain = team_visitor(service)
    code = secret_in(captain.send("/team", "/team/invite").text)
    assert code not in captain.get("/team").text
    ann = visitor(service)
    filled = {"code": code, "name": "Ann", "email": "ann@example.org", "password": PASSWORD}
    assert ann.post("/join", data=filled | {"email": "a@b\r\nBcc: c@d"}).status_code == 422
    made = ann.post("/join", data=filled)
    assert (made.status_code, made.headers["cache-control"]) == (201, "no-store")
    secret = secret_in(made.text)
    page = ann.get("/team").text
    assert "ann@example.org" in page
    assert 'action="/team/remove"' not in page
    assert ann.send("/team", "/team/invite").status_code == 403

    status, browser = sign_in(service, PASSWORD)
    assert (status, browser.get("/team").status_code) == (303, 200)
    assert sign_in(service, "wrong")[0] == 401
    ended = id_beside(ann.get("/team").text, "revoke")  # the newest: that browser
    assert ann.send("/team", "/team/revoke", id=ended).status_code == 303
    assert browser.get("/team").status_code == 303
    status, browser = sign_in(service, PASSWORD)
    form = FORM_TOKEN.search(browser.get("/team").text)
    assert form is not None
    cookies = Cookies(browser.cookies)
    assert browser.post("/sign-out", data={"form_token": form[1]}).status_code == 303
    browser.cookies.update(cookies)
    assert browser.get("/team").status_code == 303, "a session that was signed out is over, whoever kept its cookie"

    renewed = secret_in(ann.send("/team", "/team/token").text)
    assert ann.get("/team").status_code == 200
    assert visitor(service).post("/sign-in", data={"token": secret}).status_code == 401
    assert visitor(service, renewed).get("/team").status_code == 200
    new = PASSWORD + "!"
    assert ann.send("/team", "/team/password", password=new).status_code == 303, "she has just joined"
    assert ann.send("/team", "/team/me", email="").status_code == 303
    assert "ann@example.org" not in ann.get("/team").text
    assert ann.send("/team", "/team/notices", finished="yes", deadline="yes").status_code == 303
    boxes = re.findall(r'name="(\w+)" type="checkbox" value="yes"( checked)?', ann.get("/team").text)
    assert {name for name, ticked in boxes if ticked} == {"finished", "deadline"}
    assert [name for name, _ in boxes] == [kind.value for kind in NoticeKind if kind is not NoticeKind.CONFIRMATION]
    assert sign_in(service, new)[0] == 303
    assert captain.send("/team", "/team/captain", id=id_beside(captain.get("/team").text, "captain")).status_code == 303
    assert ann.send("/team", "/team/leave").status_code == 422
    with service.database.transaction() as session:
        assert teams.find(session, "Team A").name == "Team A"
    assert captain.send("/team", "/team/remove", id="x").status_code == 422
    data = captain.get("/team/data.json")
    assert (data.headers["cache-control"], data.json()["team"]["name"]) == ("no-store", "Team A")
    assert captain.send("/team", "/team/nothing").status_code == 404


def test_nobody_is_locked_out_of_a_known_device_by_those_who_guess(service: CliService) -> None:
    captain = team_visitor(service, "Owls")
    code = secret_in(captain.send("/team", "/team/invite").text)
    joining = {"code": code, "name": "Eve", "email": "", "password": PASSWORD}
    assert visitor(service).post("/join", data=joining).status_code == 201
    given = {"team": "Owls", "member": "Eve", "password": PASSWORD}
    eve = visitor(service)
    assert eve.post("/sign-in/password", data=given).status_code == 303
    guesses = [visitor(service).post("/sign-in/password", data=given | {"password": "guess"}) for _ in range(6)]
    assert [answer.status_code for answer in guesses] == [401] * 5 + [429]
    assert eve.post("/sign-in/password", data=given).status_code == 303


def test_who_has_no_team_has_no_team_page_and_another_site_changes_nothing(service: CliService) -> None:
    organizer = visitor_of_role(service, Role.ORGANIZER)
    assert organizer.get("/team").status_code == 404
    assert 'href="/team"' not in organizer.get("/submissions").text
    assert visitor(service).get("/team").status_code == 303
    captain = team_visitor(service, "Bees")
    assert captain.post("/team/invite", data={"form_token": "guess"}).status_code == 403
    foreign = captain.post("/team/invite", data={}, headers={"sec-fetch-site": "cross-site"})
    assert foreign.status_code == 403


def test_after_the_lock_date_the_page_offers_no_change_of_the_team(service: CliService) -> None:
    captain = visitor(service)
    assert captain.post("/register", data={"name": "Locked", "contact": ""}).status_code == 201
    code = secret_in(captain.send("/team", "/team/invite").text)
    guest = visitor(service)
    assert guest.post("/join", data={"code": code, "name": "Guest", "email": "", "password": ""}).status_code == 201
    changes = [f'action="/team/{name}"' for name in ("invite", "captain", "remove")]
    assert all(change in captain.get("/team").text for change in changes)
    assert 'action="/team/leave"' in guest.get("/team").text
    with service.database.transaction() as session:
        put_in_place(session, make_competition(teams_locked=(datetime.now(UTC) - timedelta(seconds=1)).isoformat()))
    page = captain.get("/team").text
    assert "Teams have been locked since" in page
    assert not [change for change in changes if change in page]
    assert 'action="/team/me"' in page, "one's own address and password stay one's own"
    assert 'action="/team/leave"' not in guest.get("/team").text
    assert "Teams have been locked since" in visitor(service).get("/register").text
    assert guest.send("/team", "/team/leave").status_code == 403
