"""Pages of a service with two competitions on the same track, and of one with a single competition."""

import re
from collections.abc import Iterator
from typing import Any

import pytest
from cli_service import CliService, cli_service
from served_pages import PageVisitor, team_visitor, visitor, visitor_of_role
from service_client import make_archive
from service_factories import TASK, TRACK, complete_scored, make_principal, make_score, submit
from sqlalchemy import select
from vitac.server.accounts import tokens
from vitac.server.competitions.applying import freeze_boards
from vitac.server.database.engine import Database
from vitac.server.database.models import Rejudgement, Submission
from vitac.server.database.states import Role
from vitac.server.principals import CONSOLE

from competitions import make_competition, open_now, put_in_place

MAIN, CLASS = "cup", "class"
BOARDS = {name: f"/competitions/{name}/tracks/{TRACK}" for name in (MAIN, CLASS)}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CliService]:
    """A service where the Ants have a result in each of two open competitions; the boards of the cup are frozen."""
    with cli_service(tmp_path_factory.mktemp("service") / "state") as service:
        with service.database.transaction() as session:
            for name in (MAIN, CLASS):
                days = {"appeal_days": 7} if name == CLASS else {"prizes": [{"place": "first", "amount": 1500}]}
                put_in_place(session, open_now(make_competition(name=name, title=f"The <{name}>", **days)))
            freeze_boards(session, CONSOLE, MAIN)
            ants = make_principal(session, "Ants")
            for name, successes in ((MAIN, 40), (CLASS, 90)):
                complete_scored(session, submit(session, ants, name, competition=name), {TASK: make_score(successes)})
        yield service


@pytest.fixture
def class_organizer(service: CliService) -> PageVisitor:
    with service.database.transaction() as session:
        issued = tokens.issue(session, CONSOLE, role=Role.ORGANIZER, label="school", competition=CLASS, lifetime=None)
    return visitor(service, issued.secret)


def submission_to(database: Database, competition: str) -> str:
    with database.transaction() as session:
        return str(session.scalars(select(Submission.id).where(Submission.competition == competition)).first())


def test_the_front_page_leads_to_all_competitions_with_their_stages_prizes_and_results(service: CliService) -> None:
    html = visitor(service).get("/").text.replace("\N{NO-BREAK SPACE}", " ").replace("\N{NARROW NO-BREAK SPACE}", " ")
    header, main = html.split("<main")
    assert '<a href="/competitions">Competitions</a>' in header
    for name in (MAIN, CLASS):
        assert main.count(f'<a class="button plain" href="/competitions/{name}">The &lt;{name}&gt;</a>') == 1
        assert f"The &lt;{name}&gt;: Simulation is open until" in main
    assert main.count("<strong>Simulation</strong> is open until <time") == 2
    assert "Prizes of 1 500 USD in all" in main
    assert "Open for practice" not in main.partition('id="tracks"')[2].partition("<details>")[0].partition("</li>")[0]
    assert "90.0 %" in main.partition('id="recent"')[2], "the boards of the other competition are frozen"
    assert "No result is on the leaderboards yet" not in main


def test_earlier_results_stay_on_the_front_page_when_the_next_stage_opens(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    with cli_service(tmp_path_factory.mktemp("next stage") / "state") as service:
        with service.database.transaction() as session:
            put_in_place(session, open_now(make_competition()))
            made = submit(session, make_principal(session, "Ants"))
            complete_scored(session, made, {TASK: make_score(90)})
            put_in_place(session, open_now(make_competition(), stage=1))
        main = visitor(service).get("/").text.split("<main")[1]
        assert "Final is open until" in main
        assert "No result is on the leaderboards yet" not in main
        assert "1 team ranked in Simulation" in main
        assert f'in <a href="/tracks/{TRACK}?stage=stage1">' in main
        board = visitor(service).get(f"/tracks/{TRACK}").text
        assert f'<a href="/tracks/{TRACK}?stage=stage1">results of Simulation</a>' in board


def test_announcements_and_warnings_of_a_competition_stand_on_its_pages_and_those_of_the_service_on_all(
    service: CliService, class_organizer: PageVisitor
) -> None:
    organizer = visitor_of_role(service, Role.ORGANIZER)
    organizer.send("/desk", "/desk/announce", title="Maintenance", text="On Sunday.")
    organizer.send("/desk", "/desk/announce", title="Of the cup", text="Its final.", competition=MAIN)
    assert class_organizer.send("/desk", "/desk/announce", title="Of the class", text="Homework.").status_code == 303
    everybody, of = visitor(service), {name: f"/competitions/{name}" for name in (MAIN, CLASS)}
    titles = {name: re.findall(r"<h3>(.*?)</h3>", everybody.get(of[name]).text) for name in of}
    assert titles == {MAIN: ["Of the cup", "Maintenance"], CLASS: ["Of the class", "Maintenance"]}
    for name in (MAIN, CLASS):
        said = f'<a href="{of[name]}">The &lt;{name}&gt;</a>'
        assert said in everybody.get("/announcements").text.partition("<main")[2]
        asked = everybody.get(f"/api/v1/announcements?competition={name}").json()["items"]
        assert [one["competition"] for one in asked] == [name, None]
    desk = class_organizer.get("/desk").text
    assert "Of the class" in desk
    assert "Maintenance" not in desk.partition('id="announce"')[2]
    refused = class_organizer.send("/desk", "/desk/announce", title="Not ours", text="Text.", competition=MAIN)
    assert refused.status_code == 403
    foreign = next(one["id"] for one in asked_all(everybody) if one["title"] == "Of the cup")
    assert class_organizer.send("/desk", "/desk/withdraw", id=str(foreign)).status_code == 403
    assert "ranks on a public list" in everybody.get(of[CLASS]).text
    for page in (of[MAIN], BOARDS[MAIN], f"/submissions/{submission_to(service.database, MAIN)}"):
        assert "The &lt;class&gt; ranks on a public list" not in organizer.get(page).text


def asked_all(browser: PageVisitor) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = browser.get("/api/v1/announcements").json()["items"]
    return found


def test_every_competition_has_its_pages(service: CliService) -> None:
    everybody = visitor(service)
    listed = everybody.get("/competitions").text
    for name in (MAIN, CLASS):
        assert f'<a href="/competitions/{name}">The &lt;{name}&gt;</a>' in listed
        of_competition = everybody.get(f"/competitions/{name}").text
        assert f"<h1>The &lt;{name}&gt;</h1>" in of_competition
        assert f'href="{BOARDS[name]}"' in of_competition
        assert everybody.get(f"/competitions/{name}/archive").status_code == 404
        for page in ("", "/logs", "/logs.csv", "/text-logs.csv", f"?task={TASK}", "?stage=stage1"):
            assert everybody.get(BOARDS[name] + page).status_code == 200
    assert everybody.get("/competitions/cap").status_code == 404
    assert everybody.get(f"/competitions/{MAIN}/tracks/track_3").status_code == 422
    assert 'href="/competitions"' in everybody.get("/competition").text


def test_the_board_of_a_competition_stays_in_it(service: CliService) -> None:
    board = visitor(service).get(BOARDS[CLASS]).text
    assert "90.0\N{NO-BREAK SPACE}%" in board
    for target in (f"{BOARDS[CLASS]}?task={TASK}", f"{BOARDS[CLASS]}/leaderboard.csv", f"{BOARDS[CLASS]}/logs"):
        assert f'href="{target}"' in board
    assert f'href="/api/v1/competitions/{CLASS}/leaderboards/{TRACK}"' in board
    assert f'<a href="{BOARDS[MAIN]}"' in board  # the same board of the other competition
    assert f'<a href="{BOARDS[CLASS]}" aria-current="page"' in board


def test_frozen_boards_show_new_results_to_organizers_of_that_competition_only(
    service: CliService, class_organizer: PageVisitor
) -> None:
    organizer = visitor_of_role(service, Role.ORGANIZER)
    rows = {
        who: len(browser.get(f"{BOARDS[MAIN]}/leaderboard.csv").text.splitlines()) - 1
        for who, browser in (("all", organizer), ("class", class_organizer), ("nobody", visitor(service)))
    }
    assert rows == {"all": 1, "class": 0, "nobody": 0}


def test_an_organizer_of_one_competition_is_led_to_what_belongs_to_it(
    service: CliService, class_organizer: PageVisitor
) -> None:
    listed = class_organizer.get("/submissions").text
    own, other = submission_to(service.database, CLASS), submission_to(service.database, MAIN)
    assert own in listed
    assert other not in listed
    shown = class_organizer.get(f"/submissions/{own}").text
    assert f'<a href="/competitions/{CLASS}">The &lt;class&gt;</a>' in shown
    assert f'href="{BOARDS[CLASS]}?stage=stage1"' in shown
    assert class_organizer.get(f"/submissions/{other}").status_code == 404
    assert class_organizer.get("/operations").status_code in {403, 404}
    assert 'href="/operations"' not in listed
    assert class_organizer.get(f"/competitions/{CLASS}/appeals").status_code == 200


def test_the_desk_of_an_organizer_of_one_competition_has_only_what_belongs_to_it(
    service: CliService, class_organizer: PageVisitor
) -> None:
    desk = class_organizer.get("/desk").text
    assert f'href="{BOARDS[CLASS]}?stage=stage1"' in desk
    assert f'href="{BOARDS[MAIN]}?stage=stage1"' not in desk
    for of_the_service in ('id="waiting"', 'id="questions"', 'id="audit"'):
        assert of_the_service not in desk
        assert of_the_service in visitor_of_role(service, Role.ORGANIZER).get("/desk").text
    assert team_visitor(service).get("/desk").status_code == 403


def test_an_organizer_freezes_the_boards_of_the_own_competition_on_its_page(
    service: CliService, class_organizer: PageVisitor
) -> None:
    page = f"/competitions/{CLASS}"

    def rows() -> int:
        return len(visitor(service).get(f"{BOARDS[CLASS]}/leaderboard.csv").text.splitlines())

    before = rows()
    assert class_organizer.send(page, f"{page}/freeze", id=CLASS).headers["location"] == page
    assert (before, rows()) == (2, 2), "results of before stay"
    assert "Others do not see new results" in class_organizer.get(page).text
    assert class_organizer.send(page, f"{page}/unfreeze", id=CLASS).status_code == 303
    assert "Freeze the leaderboards" in class_organizer.get(page).text
    refused = class_organizer.send(page, f"/competitions/{MAIN}/unfreeze", id=MAIN)
    assert refused.status_code == 403
    assert f"/competitions/{MAIN}/unfreeze" not in class_organizer.get(f"/competitions/{MAIN}").text
    assert "/freeze" not in team_visitor(service).get(page).text


def test_the_links_of_a_competition_are_those_of_its_receipts(service: CliService) -> None:
    links = {
        name: visitor(service).get(f"/api/v1/competitions/{name}/receipts").json()["items"] for name in (MAIN, CLASS)
    }
    assert {link["board"].split("/")[0] for link in links[MAIN]} == {MAIN}
    assert {link["board"].split("/")[0] for link in links[CLASS]} == {CLASS}
    whole = visitor(service).get("/api/v1/receipts").json()
    assert len(whole["items"]) == whole["receipts"] == sum(map(len, links.values()))
    first = visitor(service).get(f"/api/v1/competitions/{CLASS}/receipts?limit=1").json()
    assert first["items"] == links[CLASS][:1]
    assert first["next_after"] == (links[CLASS][0]["number"] if len(links[CLASS]) > 1 else None)
    assert f"/api/v1/competitions/{CLASS}/receipts" in visitor(service).get(f"/competitions/{CLASS}/receipts").text
    assert visitor(service).get("/competitions/cap/receipts").status_code == 404


def test_an_appeal_made_on_the_page_of_a_competition_leads_back_to_it(service: CliService) -> None:
    page = f"/competitions/{CLASS}/appeals"
    ants = team_visitor(service, "Ants")
    assert f'action="{page}/open"' in ants.get(page).text
    without = ants.get(f"/competitions/{MAIN}/appeals").text
    assert "No appeals are taken now." in without
    assert "<form" not in without.partition("<main")[2]


def test_the_desk_names_the_competition_of_each_stage(service: CliService) -> None:
    desk = visitor_of_role(service, Role.ORGANIZER).get("/desk").text
    for name in (MAIN, CLASS):
        assert f'<a href="{BOARDS[name]}?stage=stage1">The &lt;{name}&gt;, Touch, Simulation</a>' in desk
        assert f'<a href="/desk/competitions/{name}/tracks/{TRACK}/stages/stage2">' in desk
        assert f'<a href="/desk/competitions/{name}">Winners, end and results of The &lt;{name}&gt;</a>' in desk


def test_the_form_of_rejudging_names_the_competition(service: CliService, class_organizer: PageVisitor) -> None:
    organizer = visitor_of_role(service, Role.ORGANIZER)
    organizer.send("/rejudging", "/rejudging/start", track=TRACK, competition=MAIN, reason="look again")
    with service.database.transaction() as session:
        assert session.scalars(select(Rejudgement.competition)).all() == [MAIN]
    assert "The &lt;cup&gt;, Touch, Simulation: look again" in organizer.get("/rejudging").text
    assert "look again" not in class_organizer.get("/rejudging").text
    refused = class_organizer.send("/rejudging", "/rejudging/start", track=TRACK, competition=MAIN, reason="no")
    assert refused.status_code == 403
    assert "concerns cup" in refused.text


def test_the_form_of_uploads_asks_for_the_competition_while_several_take_the_track(service: CliService) -> None:
    team = team_visitor(service)
    assert '<option value="class">The &lt;class&gt;</option>' in team.get("/submissions/upload").text
    files = {"file": ("mine.zip", make_archive())}
    refused = team.send("/submissions/upload", "/submissions/upload", files=files)
    assert "take submissions to track_1 now: class, cup" in refused.text
    taken = team.send("/submissions/upload", "/submissions/upload", files=files, competition=MAIN)
    assert taken.status_code == 303
    assert f'<a href="/competitions/{MAIN}">' in team.get(taken.headers["location"]).text


def test_a_single_competition_looks_as_if_there_could_be_no_other(tmp_path_factory: pytest.TempPathFactory) -> None:
    with cli_service(tmp_path_factory.mktemp("single") / "state") as service:
        with service.database.transaction() as session:
            put_in_place(session, open_now(make_competition()))
            made = submit(session, make_principal(session, "Ants"))
            complete_scored(session, made, {TASK: make_score(90)})
        organizer = visitor_of_role(service, Role.ORGANIZER)
        for page in (
            "/",
            "/competition",
            f"/tracks/{TRACK}",
            f"/tracks/{TRACK}/logs",
            "/submissions",
            f"/submissions/{made.id}",
            "/submissions/upload",
            "/rejudging",
            "/desk",
        ):
            shown = organizer.get(page)
            assert shown.status_code == 200, page
            assert '"/competitions' not in shown.text, page
            assert 'name="competition"' not in shown.text, page
