import re
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal
from zoneinfo import ZoneInfo

import checked_pages
import pytest
from browser_checks import DESK, PHONE, ZOOMED, Complaints, violations
from checked_pages import WITH_SCENES, unchecked
from fastapi import APIRouter
from page_fixtures import a_sandbox
from playwright.sync_api import Browser, Page, Route, expect
from seeded_site import BEARS, GELBOTS, ORGANIZERS, form_token
from service_client import make_archive
from service_factories import TASK, add_result, make_score, play_all, submit_refuted_log
from site_under_test import SiteUnderTest
from sqlalchemy import update
from submission_steps import make_worker
from uploaded_logs import a_text_log
from vitac.evaluator.version import evaluator_version
from vitac.server.database.models import BoardResult, Submission, Team
from vitac.server.database.states import WorkerState
from vitac.server.decisions.finishing import finalize
from vitac.server.principals import CONSOLE
from vitac.web.pages.service import sandbox
from waiting import answered, resize, until

from competitions import make_competition, moved, open_now

LINES_OF_TEXT = """cell => {
    const range = document.createRange();
    range.selectNodeContents(cell);
    return range.getClientRects().length;
}"""
LOOKS: tuple[tuple[Literal["light", "dark"], dict[str, int]], ...] = (("light", DESK), ("dark", PHONE))
A4_PAPER = {"width": 720, "height": 1050}  # px at 96 dpi, without margins


def show_everything(site: SiteUnderTest) -> None:
    """Add logs of each kind, an evaluation that was cancelled, workers, and a competition that is final."""
    seeded = site.seeded
    gelbots = seeded.visitor(GELBOTS)
    logs = {"file": ("old.log", a_text_log(GELBOTS))}
    sent = gelbots.post("/submissions/upload", data={"form_token": form_token(gelbots)}, files=logs)
    gelbots.post(f"{site.path_of('runs')}/cancel", data={"form_token": form_token(gelbots)})
    with seeded.database.transaction() as session:
        refuted = submit_refuted_log(session, seeded.seed.people[GELBOTS], "refuted")
        text_log = session.get_one(Submission, sent.headers["location"].rpartition("/")[2])
    play_all(seeded.database, text_log)
    seeded.added |= {"refuted": refuted.id, "text log": text_log.id}
    content = make_competition(prizes=[{"place": "first", "amount": 2000, "note": "a talk"}])
    del content["tracks"]["track_1"]["stages"][1]
    seeded.hold(open_now(content))
    seeded.score("Tactile Bears with a long name", "marker transformer with a long name", 200)
    seeded.hold(moved(content, days=-60))
    with seeded.database.transaction() as session:
        finalize(session, CONSOLE)
    for number in (1, 2):
        make_worker(seeded.database, host=f"machine-{number}", sandbox=a_sandbox().model_dump(mode="json"))


@pytest.mark.slow
def test_pages_are_accessible_fit_and_raise_no_error(page: Page, site: SiteUnderTest) -> None:
    """In both looks, one after the other; that a page may be opened once for both is the next test."""
    show_everything(site)
    complaints = Complaints(page)
    page.emulate_media(reduced_motion="reduce")  # else the front page plays: scenes have tests of their own
    site.sign_in(page)
    for path in site.paths():
        site.open(page, path)
        expect(page.get_by_role("heading", level=1)).to_be_visible()
        assert page.evaluate("document.getAnimations().length") == 0, f"{path} moves"
        for scheme, size in LOOKS:
            page.emulate_media(color_scheme=scheme)
            resize(page, size)
            assert page.evaluate("document.documentElement.scrollWidth") <= size["width"], f"{path} scrolls sideways"
            assert violations(page) == [], f"{path}, {scheme}"
    assert complaints.heard == []


def test_no_script_asks_for_size_or_colours_but_the_player_which_has_tests_of_both(repository: Path) -> None:
    asks = re.compile(
        r"matchMedia(?!\(.\(prefers-reduced-motion)|(inner|client|offset|scroll)(Width|Height)|getBoundingClientRect|ResizeObserver"
    )
    scripts = (repository / "web" / "static").glob("*.js")
    assert [path.name for path in scripts if asks.search(path.read_text(encoding="utf-8"))] == ["playback.js"]


def test_every_page_is_looked_at_for_barriers(site: SiteUnderTest, monkeypatch: pytest.MonkeyPatch) -> None:
    assert unchecked(site.paths()) == []
    for page, module in WITH_SCENES.items():
        assert "violations(" in Path(__file__).with_name(f"{module}.py").read_text(encoding="utf-8"), page
    router = APIRouter()
    router.add_route("/new/{thing}", sandbox, methods=["GET"])
    router.add_route("/new/{thing}.csv", sandbox, methods=["GET"])
    monkeypatch.setattr(checked_pages, "pages", lambda: router)
    assert unchecked(site.paths()) == ["/new/{thing}"]
    assert unchecked(["/new/one?of=many"]) == []


@pytest.mark.slow
@pytest.mark.parametrize("scripted", [True, False])
def test_operations_are_accessible_fit_and_need_no_javascript(
    browser: Browser, site: SiteUnderTest, scripted: bool
) -> None:
    make_worker(site.seeded.database, host="machine-1")
    make_worker(site.seeded.database, state=WorkerState.REFUSING, message="The sandbox does not hold. " * 5)
    context = browser.new_context(java_script_enabled=scripted)
    page = context.new_page()
    site.sign_in(page, ORGANIZERS)
    page.locator("a[href='/operations']").first.click()
    expect(page.locator("h1")).to_have_text("Operations")
    expect(page.locator("text=machine-1").first).to_be_visible()
    for scheme, size in LOOKS if scripted else ():
        page.emulate_media(color_scheme=scheme)
        resize(page, size)
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
        assert violations(page) == []
    context.close()


def test_an_empty_site_is_accessible(page: Page, site: SiteUnderTest) -> None:
    with site.seeded.database.transaction() as session:
        session.execute(update(BoardResult).values(is_off_boards=True))
    page.emulate_media(reduced_motion="reduce")  # as above
    site.enter(page, ORGANIZERS)
    for path in ("/", "/tracks/track_1"):
        site.open(page, path)
        assert violations(page) == []


def test_a_frame_without_a_public_episode_is_accessible(page: Page, site: SiteUnderTest) -> None:
    site.open(page, f"/embed{site.path_of('done')}/episodes/{TASK}/5")
    expect(page.get_by_text("There is no public episode here")).to_be_visible()
    assert violations(page) == []


def test_a_running_evaluation_moves_on_without_a_reload_and_ends_with_its_score(
    page: Page, site: SiteUnderTest
) -> None:
    site.enter(page)
    site.open(page, site.path_of("runs"))
    page.evaluate("window.sameDocument = true")
    expect(page.get_by_text("137 of 270")).to_be_visible()
    site.seeded.play_on("runs")
    expect(page.get_by_text("138 of 270")).to_be_visible()
    assert page.evaluate("window.sameDocument") is True
    cells = page.locator("rect.cell:not(.waiting)")
    expect(cells).to_have_count(138 + page.locator(".key rect.cell:not(.waiting)").count())
    site.seeded.play_on("runs", to_end=True)
    expect(page.get_by_text("179 of 270 from 90 starts")).to_be_visible()
    expect(page.get_by_role("button", name="Cancel this evaluation")).to_have_count(0)


def test_a_running_state_pulses_unless_the_reader_wants_no_motion(page: Page, site: SiteUnderTest) -> None:
    site.enter(page)
    site.open(page, site.path_of("runs"))
    assert page.evaluate("document.getAnimations().length") == 1
    page.emulate_media(reduced_motion="reduce")
    assert page.evaluate("document.getAnimations().length") == 0


def test_a_change_of_state_is_announced(page: Page, site: SiteUnderTest) -> None:
    site.enter(page, BEARS)
    site.open(page, site.path_of("waits"))
    expect(page.get_by_role("status")).to_have_text("")
    site.seeded.play_on("waits")
    expect(page.get_by_role("status")).to_have_text("Running")


@pytest.mark.slow
def test_everything_works_without_javascript(browser: Browser, site: SiteUnderTest) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    site.open(page, "/")
    expect(page.locator("img.still")).to_be_visible()
    expect(page.locator("#play-example")).to_be_hidden()
    site.sign_in(page)
    page.get_by_role("link", name="runs").click()
    expect(page.get_by_text("137 of 270")).to_be_visible()
    # Playwright's text and role queries leave out what stands in <noscript>.
    refresh = page.locator("noscript p")
    expect(refresh).to_contain_text("This page reloads itself every 5 seconds.")
    expect(refresh).to_be_visible()
    site.seeded.play_on("runs")
    expect(page.get_by_text("138 of 270")).to_be_visible()

    def stop_reloading() -> str | None:
        if "refresh=off" not in page.url:  # a reload may come between
            page.locator("noscript a").click()
        return refresh.text_content()

    until(page, stop_reloading, lambda text: text and text.startswith("This page does not reload itself."))
    with answered(page):
        page.get_by_role("button", name="Cancel this evaluation").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("runs")
    expect(page.get_by_text("Cancelled", exact=True)).to_be_visible()
    page.get_by_role("button", name="Sign out").click()
    expect(page.get_by_role("link", name="Sign in")).to_be_visible()
    context.close()


def test_the_keyboard_reaches_the_content_first(page: Page, site: SiteUnderTest) -> None:
    site.open(page, "/tracks/track_1")
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="Skip to the content")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("#main")).to_be_focused()


def test_focus_is_visible(page: Page, site: SiteUnderTest) -> None:
    site.open(page, "/tracks/track_1")
    for _ in range(3):
        page.keyboard.press("Tab")
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"


def test_scripts_of_others_are_refused_by_the_policy(page: Page, site: SiteUnderTest) -> None:
    site.open(page, "/tracks/track_1")
    page.evaluate(
        "() => { const script = document.createElement('script');"
        " script.textContent = 'window.injected = true'; document.body.append(script); }"
    )
    assert page.evaluate("window.injected") is None


def test_the_session_cookie_is_out_of_reach_for_scripts(page: Page, site: SiteUnderTest) -> None:
    site.sign_in(page)
    assert page.evaluate("document.cookie") == ""
    cookies = page.context.cookies()
    assert [(cookie["name"], cookie["httpOnly"], cookie["sameSite"]) for cookie in cookies] == [
        ("vitac_session", True, "Strict")
    ]


@pytest.mark.slow
def test_a_long_name_widens_no_board_of_many_teams(browser: Browser, site: SiteUnderTest) -> None:
    names = "W" * 60, ("a long name of many words " * 3)[:60]
    with site.seeded.database.transaction() as session:
        for number in range(100, 200):
            name = names[number % 2]
            team = Team(name=f"{name} {number}", name_key=f"{name} {number}".casefold())
            at = datetime.now(UTC)
            add_result(session, number, team, {TASK: make_score(number, 270)}, at).submission.name = "n" * 128
    for size, media in ((DESK, "screen"), (ZOOMED, "screen"), (PHONE, "screen"), (A4_PAPER, "print")):
        context = browser.new_context(viewport=size)  # type: ignore[arg-type]
        page = context.new_page()
        page.emulate_media(media=media)  # type: ignore[arg-type]
        site.open(page, "/tracks/track_1")
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]
        if size is PHONE:
            site.open(page, "/tracks/track_1?page=3")
            assert page.locator("tr:not(.reference) > td.rank").last.evaluate(LINES_OF_TEXT) == 1, (
                "a rank of three digits"
            )
        if size is DESK:  # elsewhere a table is a list
            site.sign_in(page, ORGANIZERS)
            for name in names:
                expect(page.get_by_role("cell", name=name[:20]).first).to_be_visible()
            assert page.evaluate("document.documentElement.scrollWidth") <= size["width"], "list of all teams"
        context.close()


@pytest.mark.slow
def test_the_own_row_of_a_long_board_is_one_link_away(page: Page, site: SiteUnderTest) -> None:
    site.seeded.fill_board(120)
    of_both = BoardResult.submission_id == site.seeded.id_of("both")
    with site.seeded.database.transaction() as session:
        session.execute(update(BoardResult).where(of_both).values(is_off_boards=True))
    site.enter(page)
    site.open(page, "/tracks/track_1")
    page.get_by_role("link", name="Your team").click()
    expect(page.locator("#own")).to_contain_text("Gelbots")
    expect(page.locator("#own")).to_be_in_viewport()
    page.get_by_label("Team", exact=True).fill("team 11")
    page.get_by_role("button", name="Search").click()
    expect(page.get_by_role("rowheader", name="Team")).to_have_count(10)
    assert violations(page) == []


def choose(page: Page, content: bytes) -> None:
    """Chooses a file to upload and sends the form."""
    page.get_by_role("link", name="Upload a submission").click()
    page.get_by_label("File").set_input_files({"name": "mine.zip", "mimeType": "application/zip", "buffer": content})
    page.get_by_role("button", name="Upload").click()


@pytest.mark.parametrize("scripted", [True, False])
def test_a_submission_is_uploaded_in_the_browser(browser: Browser, site: SiteUnderTest, scripted: bool) -> None:
    context = browser.new_context(java_script_enabled=scripted)
    page = context.new_page()
    site.sign_in(page)
    choose(page, b"broken" * 50_000)
    expect(page.get_by_role("alert")).to_contain_text("zip")
    site.open(page, "/submissions")
    choose(page, make_archive())
    page.wait_for_url(re.compile("/submissions/[0-9a-f-]{36}$"))
    expect(page.get_by_role("heading", level=1)).to_have_text("zero")
    context.close()


DROP = """
    (names) => {
        const files = new DataTransfer();
        for (const name of names) files.items.add(new File(["content"], name));
        const event = (kind) => new DragEvent(kind, { dataTransfer: files, bubbles: true, cancelable: true });
        const form = document.getElementById("upload");
        return [form.dispatchEvent(event("dragover")), form.dispatchEvent(event("drop"))];
    }
"""


def test_a_file_is_dropped_on_the_form(page: Page, site: SiteUnderTest) -> None:
    site.enter(page)
    site.open(page, "/submissions/upload")
    page.evaluate(DROP, ["a.zip", "b.zip"])
    expect(page.get_by_text("Drop one file, got 2.")).to_be_visible()
    assert page.evaluate(DROP, ["mine.zip"]) == [False, False], "the browser does not open it"
    expect(page.get_by_text("Drop one file")).to_be_hidden()
    assert page.get_by_label("File").input_value().endswith("mine.zip")


def test_the_script_shows_how_far_an_upload_is_and_when_it_was_cut(page: Page, site: SiteUnderTest) -> None:
    site.enter(page)
    site.open(page, "/submissions/upload")
    expect(page.get_by_role("progressbar")).to_be_hidden()
    held: list[Route] = []
    page.route("**/submissions/upload", lambda route: held.append(route))
    page.get_by_label("File").set_input_files({"name": "a.zip", "mimeType": "application/zip", "buffer": b"PK"})
    page.get_by_role("button", name="Upload").click()
    expect(page.get_by_role("progressbar")).to_be_visible()
    expect(page.get_by_role("button", name="Upload")).to_be_disabled()
    until(page, lambda: held)
    held[0].abort()
    expect(page.get_by_role("alert")).to_contain_text("The connection was cut.")
    expect(page.get_by_role("button", name="Upload")).to_be_enabled()


def test_the_front_page_shows_what_happens_meanwhile(page: Page, site: SiteUnderTest) -> None:
    page.emulate_media(reduced_motion="reduce")
    page.clock.install()
    site.open(page, "/")
    expect(page.get_by_text("1 evaluation runs now, 1 in the queue.")).to_be_visible()
    expect(page.locator("#news li")).to_have_count(2)
    page.evaluate("window.sameDocument = true")
    site.seeded.score("Newcomers", "new", 260)
    page.clock.run_for(15_000)
    expect(page.locator("#news li")).to_contain_text(["of Newcomers:", "of Gelbots:", "of Bears:"])
    assert page.evaluate("window.sameDocument") is True


def test_times_and_decimals_are_written_as_the_reader_does(browser: Browser, site: SiteUnderTest) -> None:
    context = browser.new_context(locale="de-DE", timezone_id="Asia/Tokyo")
    page = context.new_page()
    complaints = Complaints(page)
    site.open(page, "/tracks/track_1")
    time = page.locator(".when time").first
    moment = datetime.fromisoformat(time.get_attribute("datetime") or "")
    expect(time).to_have_attribute("title", f"{moment:%Y-%m-%d %H:%M} UTC")
    expect(time).to_contain_text(f"{moment.astimezone(ZoneInfo('Asia/Tokyo')):%H:%M}")
    expect(page.locator(".rate-number").first).to_have_text(re.compile(r"^\d+,\d\s%$"))
    expect(page.locator(".footer")).to_contain_text("Times are yours (Asia/Tokyo)")
    expect(page.get_by_text(evaluator_version())).to_have_count(1)
    assert complaints.heard == []
    context.close()


def test_what_an_event_brings_is_in_the_readers_own_time_too(browser: Browser, site: SiteUnderTest) -> None:
    context = browser.new_context(timezone_id="Asia/Tokyo", locale="de-DE")
    page = context.new_page()
    make_worker(site.seeded.database, heartbeat_at=datetime.now(UTC) - timedelta(hours=1))
    site.enter(page, BEARS)
    site.open(page, site.path_of("waits"))
    last = page.locator("#live time")
    expect(last).to_have_attribute("title", re.compile("UTC$"))
    site.seeded.play_on("waits", to_end=True)
    expect(page.locator(".facts dd").first).to_contain_text(re.compile(r"\d,\d\s%"))
    context.close()


def test_paper_has_what_is_to_read_and_no_controls(page: Page, site: SiteUnderTest) -> None:
    site.enter(page)
    page.emulate_media(media="print", reduced_motion="reduce", color_scheme="dark")
    resize(page, A4_PAPER)
    for path, printed in (
        ("/", "img.still"),
        ("/tracks/track_1", ".board tbody tr"),
        ("/tracks/track_1/rules", "table.limits"),
        (site.path_of("done"), "svg.map"),
        ("/compare", "h1"),
        ("/docs/deployment", ".document table"),
    ):
        site.open(page, path)
        expect(page.locator(f"{printed} >> visible=true").first).to_be_visible()
        expect(
            page.locator(
                ":is(button, .button, input, select, textarea, details:not([open]) > summary, nav a) >> visible=true"
            )
        ).to_have_count(0)
        assert page.evaluate("document.documentElement.scrollWidth") <= A4_PAPER["width"], f"{path} is cut"
        paper = page.evaluate("getComputedStyle(document.querySelector('h1')).color")
        assert paper == "rgb(0, 0, 0)", f"{path} is printed in {paper}"


def test_an_open_table_behind_a_plot_is_printed_whole(page: Page, site: SiteUnderTest) -> None:
    site.enter(page)
    site.open(page, site.path_of("done"))
    page.get_by_text("Table: Cuboid").click()
    table = page.get_by_role("region", name="Table: Cuboid")
    is_cut = "part => part.scrollHeight > part.clientHeight + 1"
    assert table.evaluate(is_cut)
    page.emulate_media(media="print")
    assert not table.evaluate(is_cut)
