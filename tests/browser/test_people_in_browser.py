"""One evaluation and what is said about it, through the eyes of each role."""

from collections.abc import Iterator
from datetime import datetime, timedelta
from zoneinfo import ZoneInfo

import pytest
from browser_checks import DESK, ZOOMED, Complaints, violations
from checked_pages import BOARD, COMPETITION, PAGES_OF_ROLES
from cli_service import CliService, cli_service
from playwright.sync_api import Page, expect
from service_factories import make_principal, make_secret, play_all, submit
from vitac.server.accounts import members, messages, teams, tokens
from vitac.server.database.states import Role
from vitac.server.decisions import rejudging
from vitac.server.leaderboards.public_pages import set_public
from vitac.server.principals import CONSOLE, Principal
from vitac.server.submissions import appeals
from waiting import answered, resize

from competitions import make_competition, open_now, put_in_place, shown_stage

pytestmark = pytest.mark.slow

WEEK = timedelta(days=7)
FINGER_PX = 44  # what a finger hits, and how high every field of a form is
SEES = {
    "/appeals": "The peg was in the hole.",
    "SUBMISSION": "100.0",
    "PUBLIC": "100.0",
    BOARD: "Simulation",
    "/desk": "May we ask?",
    "/team": "Ann",
    "/judging": "The structure",
    "/competition": "All is well.",
    "/competitions": "The cup",
    COMPETITION: "Simulation",
    f"{COMPETITION}/appeals": "The peg was in the hole.",
    f"{COMPETITION}/tracks/track_1": "Simulation",
    "/rejudging": "Simulation: The worker was wrong.",
    "/operations": "Operations",
}
"""Words that the page shows to whom it concerns."""
HIDDEN = {("other", "/appeals"), ("other", "SUBMISSION"), ("visitor", "SUBMISSION")}
"""Who sees nothing of what which page shows."""


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CliService]:
    with cli_service(tmp_path_factory.mktemp("service") / "state") as service:
        yield service


@pytest.fixture(scope="module")
def secrets(service: CliService) -> dict[str, str]:
    """Tokens of each role, after something has happened that all of them may look at."""
    with service.database.transaction() as session:
        content = make_competition(appeal_days=7)
        track = content["tracks"]["track_1"]
        del track["stages"][1]
        track["judging"] = {"criteria": [{"name": "structure", "title": "The structure"}]}
        put_in_place(session, open_now(content))
        own = teams.find(session, "Team A")
        team = Principal(role=Role.TEAM, team_id=own.id, team_name=own.name, leads_team=True)
        members.join(session, members.JoiningMember(code=members.invite(session, team, own)[1], name="Ann"), WEEK)
        members.invite(session, team, own)
        submission, shared = submit(session, team), submit(session, team, "shared")
        messages.publish_announcement(session, CONSOLE, title="News", text="All is well.", notify=False)
        messages.ask_question(session, team, "May we ask?", public=True)
        teams.register(session, CONSOLE, name="Waiting", waits=True)
        other = make_secret(session, make_principal(session, "Bears"))
    for played in (submission, shared):
        play_all(service.database, played)
    with service.database.transaction() as session:
        set_public(session, team, shared.id, public=True)
        appeals.open_appeal(session, team, submission.id, "The peg was in the hole.")
        rejudging.start(session, CONSOLE, shown_stage(session, "track_1"), reason="The worker was wrong.")
        return {
            "SUBMISSION": f"/submissions/{submission.id}",
            "PUBLIC": f"/submissions/{shared.id}",
            "participant": make_secret(session, team),
            "other": other,
            "judge": tokens.issue(session, CONSOLE, role=Role.JUDGE, label="judge", lifetime=None).secret,
            "organizer": make_secret(session, CONSOLE),
        }


@pytest.mark.parametrize("role", PAGES_OF_ROLES)
def test_each_role_sees_its_pages_without_a_barrier(
    page: Page, service: CliService, secrets: dict[str, str], role: str
) -> None:
    complaints = Complaints(page)
    page.emulate_media(reduced_motion="reduce")  # else the front page plays: scenes have tests of their own
    resize(page, DESK)
    if role != "visitor":
        page.goto(f"{service.address}/sign-in")
        page.get_by_label("API token").fill(secrets[role])
        page.get_by_role("button", name="Sign in").click()
        page.wait_for_url(f"{service.address}/submissions")
    for path in PAGES_OF_ROLES[role]:
        page.goto(service.address + secrets.get(path, path))
        assert violations(page) == [], path
        resize(page, ZOOMED)
        assert page.evaluate("document.documentElement.scrollWidth") <= ZOOMED["width"], f"{path} at 200 %"
        resize(page, DESK)
        page.evaluate("document.querySelectorAll('main details').forEach((fold) => { fold.open = true; })")
        for field in page.locator("main").locator("input:not([type=hidden], [type=checkbox]), textarea, select").all():
            height, letters = field.evaluate("field => [field.offsetHeight, getComputedStyle(field).fontSize]")
            assert height >= FINGER_PX, f"{path}: {field.get_attribute('name')} is drawn by the browser"
            assert letters == "16px", "a phone would zoom in"
        if (role, path) in HIDDEN:
            assert SEES[path] not in page.content(), "what is another team's is not shown"
        elif path in SEES:
            expect(page.get_by_text(SEES[path]).first).to_be_attached()
    assert complaints.heard == []


def test_a_schedule_is_shown_in_the_readers_own_time(page: Page, service: CliService, secrets: dict[str, str]) -> None:
    complaints = Complaints(page)
    page.context.new_cdp_session(page).send("Emulation.setTimezoneOverride", {"timezoneId": "Asia/Tokyo"})
    page.goto(f"{service.address}/competition")
    schedule = page.locator("time.deadline")
    own = page.locator("time.deadline + .sub")
    assert schedule.count() > 0
    expect(own).to_have_count(schedule.count())
    moment = schedule.first.get_attribute("datetime")
    assert moment is not None
    there = datetime.fromisoformat(moment).astimezone(ZoneInfo("Asia/Tokyo"))
    expect(own.first).to_contain_text("GMT+9")
    expect(own.first).to_contain_text(str(there.day))
    expect(own.first).to_contain_text(f":{there:%M}")
    assert complaints.heard == []


def test_an_organizer_rules_with_the_form_and_the_team_reads_it(
    page: Page, service: CliService, secrets: dict[str, str]
) -> None:
    page.goto(f"{service.address}/sign-in?next=/desk")
    page.get_by_label("API token").fill(secrets["organizer"])
    page.get_by_role("button", name="Sign in").click()
    page.get_by_label("Ruling on appeal 1").fill("It was not.")
    with answered(page):
        page.get_by_role("button", name="Reject appeal 1").click()
    page.goto(f"{service.address}/appeals")
    expect(page.get_by_text("It was not.")).to_be_visible()
    expect(page.get_by_text("Rejected")).to_be_visible()


def test_pages_that_are_shown_once_have_no_barrier(page: Page, service: CliService, secrets: dict[str, str]) -> None:
    """Answers to forms: tokens and codes that are shown only now, and what was refused."""
    page.goto(f"{service.address}/sign-in?next=/team")
    page.get_by_label("API token").fill("vitac_wrong")
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("alert")).to_be_visible()
    assert violations(page) == [], "refused sign-in"
    page.get_by_label("API token").fill(secrets["participant"])
    page.get_by_role("button", name="Sign in").click()
    page.get_by_label("A stage closes within 24 hours").uncheck()
    with answered(page):
        page.get_by_role("button", name="Save the notices").click()
    expect(page.get_by_label("A stage closes within 24 hours")).not_to_be_checked()
    expect(page.get_by_label("An evaluation has a score")).to_be_checked()
    page.get_by_role("button", name="Invite a member").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("New invitation")
    assert violations(page) == [], "invitation"
    code = page.get_by_label("Invitation").inner_text()
    with answered(page):
        page.get_by_role("button", name="Sign out").click()
    for given, answer in (("vitac-join-wrong", page.get_by_role("alert")), (code, page.get_by_label("API token"))):
        page.goto(f"{service.address}/join")
        page.get_by_label("Code").fill(given)
        page.get_by_label("Your name").fill("Bea")
        page.get_by_role("button", name="Join").click()
        expect(answer).to_be_visible()
        assert violations(page) == [], given
    page.goto(f"{service.address}/team")
    page.get_by_role("button", name="Replace my token").click()
    expect(page.get_by_label("Token")).to_be_visible()
    assert violations(page) == [], "token"
    page.context.clear_cookies()
    page.goto(f"{service.address}/register")
    page.get_by_label("Team name").fill("Cats")
    page.get_by_role("button", name="Register").click()
    expect(page.get_by_label("API token")).to_be_visible()
    assert violations(page) == [], "registered team"
