import io
import re
import shutil
from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest
from browser_checks import DESK, PHONE, violations
from fastapi import FastAPI
from PIL import Image
from played_episodes import ask_for_playback, guided, path_of_episode
from playwright.sync_api import Browser, Locator, Page, Route, expect
from real_browser import NO_WEBGL, SOFTWARE_WEBGL, launched
from seeded_site import GELBOTS, form_token
from service_client import serving
from site_under_test import SiteUnderTest
from starlette.responses import HTMLResponse
from submission_steps import make_worker
from vitac.evaluator.tracks import find_task
from vitac.server.database.states import WorkState
from vitac.web.pages.episodes import player_script
from waiting import resize, until, wait_for_rest

pytestmark = pytest.mark.slow(minutes=3)

HOUR_S = 3600  # later than a page of which only the clock is told to go on can be
PEG, LOCK, FUSION, SLIP = "peg-insertion", "lock-opening", "fusion-insertion", "slip"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """A browser that renders WebGL in software."""
    assert player_script() is not None, (
        "The player is not built; ./vitac test builds it where npm's packages can be had."
    )
    with launched(*SOFTWARE_WEBGL) as browser:
        yield browser


@pytest.fixture
def page(browser: Browser, site: SiteUnderTest) -> Iterator[Page]:
    """A page of somebody who is signed in; it may complain of nothing."""
    context = browser.new_context(viewport=DESK)  # type: ignore[arg-type]
    page = context.new_page()
    heard: list[str] = []
    page.on("pageerror", lambda error: heard.append(str(error)))
    page.on(
        "console",
        lambda message: (
            heard.append(message.text) if message.type == "error" or "valid enum value" in message.text else None
        ),
    )
    site.enter(page)
    yield page
    assert heard == []
    context.close()


def made(site: SiteUnderTest, task: str = PEG, number: int = 5) -> str:
    """Path of an episode with a playback of real physics."""
    name = "both" if task in (PEG, LOCK) else f"of {task}"
    if name != "both" and name not in site.seeded.added:
        shapes = find_task(task)[1].episode_list.shapes
        site.seeded.submit(GELBOTS, name, {task: (1,) * len(shapes)})
    return ask_for_playback(site.seeded, name, number, task, state=WorkState.DONE)


def not_made(site: SiteUnderTest) -> str:
    """Path of an episode whose playback nobody has asked for, while two others wait for the only worker."""
    make_worker(site.seeded.database)
    for number in (1, 2):
        ask_for_playback(site.seeded, "done", number)
    return path_of_episode(site.seeded, "both")


def open_player(site: SiteUnderTest, page: Page, path: str) -> None:
    site.open(page, path)
    expect(page.get_by_role("form", name="Playback")).to_be_visible()


def open_layers(page: Page) -> None:
    page.get_by_text("Layers and speed").click()


def seen(place: Locator) -> bytes:
    """A picture of what is shown when all scenes of the page have come to rest: the next one is the same."""
    wait_for_rest(place.page)
    return until(place.page, lambda: (place.screenshot(), place.screenshot()), lambda pair: pair[0] == pair[1])[0]


def colours(place: Locator) -> set[tuple[int, ...]]:
    """Colours that fill a part of what is seen, to 16 levels."""
    picture = Image.open(io.BytesIO(seen(place))).convert("RGB")
    counted = picture.getcolors(picture.width * picture.height) or []
    levels: dict[tuple[int, ...], int] = {}
    for count, colour in counted:
        assert isinstance(colour, tuple)
        level = tuple(part // 16 for part in colour)
        levels[level] = levels.get(level, 0) + count
    return {level for level, count in levels.items() if count > 200}


def expect_time(page: Page, time: str) -> None:
    expect(page.get_by_label("Env step", exact=True)).to_have_value(time)


@pytest.mark.parametrize(("task", "number"), [(PEG, 5), (LOCK, 3), (FUSION, 7), (SLIP, 2)])
def test_an_episode_is_seen_in_3d_with_what_was_measured(
    site: SiteUnderTest, page: Page, task: str, number: int
) -> None:
    open_player(site, page, made(site, task, number))
    scene = page.locator("canvas.scene")
    expect(page.locator("img.still")).to_be_hidden()
    assert len(colours(scene)) > 8
    expect(page.get_by_role("img", name="marker flow")).to_have_count(2)
    expect(page.get_by_role("img", name="over the env steps")).to_have_count(5)
    expect(page.get_by_role("img", name="camera")).to_have_count(2 if task == FUSION else 0)
    expect(page.locator("polyline.again")).to_have_count(2 if task == LOCK else 0)  # of eight teeth, six have colours
    names = ("left sensor", "right sensor", "from above", "section")
    panels = [page.get_by_role("img", name=name).bounding_box() for name in names]
    assert len({panel["y"] for panel in panels if panel}) == 1, "what is felt and both sections stand in one row"
    page.get_by_text("Values of every env step").click()
    expect(page.get_by_role("rowheader")).to_have_text(
        [str(1 + step) for step in range(len(guided(task, number).rewards))]
    )
    assert violations(page) == []


def test_controls_stand_below_the_scene(site: SiteUnderTest, page: Page) -> None:
    open_player(site, page, made(site))
    for size in (DESK, {"width": 1280, "height": 900}, PHONE):
        resize(page, size)
        wait_for_rest(page)
        stage, controls = (page.locator(part).bounding_box() for part in (".stage", "form.transport"))
        assert stage
        assert controls
        assert stage["y"] + stage["height"] <= controls["y"]
        if size is not PHONE:
            assert controls["y"] + controls["height"] <= size["height"], "both in the first window"
            assert stage["height"] > 0.5 * size["height"]


def test_the_code_that_is_shared_plays_the_moment_in_a_page_of_another_site(site: SiteUnderTest, page: Page) -> None:
    site.seeded.publish("both")
    open_player(site, page, f"{made(site)}?step=1.5")
    expect_time(page, "1.5")
    page.get_by_text("Share", exact=True).click()
    expect(page.get_by_label("Link to this moment")).to_have_value(re.compile(r"/submissions/.*\?step=1\.5$"))
    code = page.get_by_label("For a page of yours").input_value()
    page.context.clear_cookies()
    paper = FastAPI()
    paper.add_route("/", lambda _: HTMLResponse(f"<link rel=icon href=data:,>{code}"))
    with serving(paper) as (_, port):
        page.goto(f"http://localhost:{port}/")
        frame = page.frame_locator("iframe")
        expect(frame.get_by_role("form", name="Playback")).to_be_visible()
        expect(frame.get_by_label("Env step", exact=True)).to_have_value("1.5")
        expect(frame.locator("canvas.scene")).to_be_visible()
    assert page.context.cookies() == []


def test_a_film_has_every_picture_is_cancelled_and_is_refused_in_words_by_a_browser_without_an_encoder(
    site: SiteUnderTest, page: Page, tmp_path: Path
) -> None:
    open_player(site, page, made(site))
    open_layers(page)
    page.get_by_label("Speed").select_option("4")
    page.get_by_text("Film", exact=True).click()
    page.get_by_label("Width").select_option("640")
    record = page.get_by_role("button", name="Record a film")
    record.click()
    expect(page.get_by_role("progressbar", name="Recorded part")).to_be_visible()
    page.get_by_role("button", name="Cancel").click()
    expect(page.get_by_text("Cancelled.")).to_be_visible()
    with page.expect_download(timeout=600e3) as downloaded:
        record.click()
    assert downloaded.value.suggested_filename == "both_episode_5_trapezoid_x_-4.00_mm_y_-2.00_mm_turned_+2.00deg.webm"
    downloaded.value.save_as(tmp_path / "film.webm")
    film = cv2.VideoCapture(str(tmp_path / "film.webm"))
    pictures = [picture for read, picture in iter(film.read, (False, None)) if read]
    assert len(pictures) == film.get(cv2.CAP_PROP_FRAME_COUNT) == 38  # 3 env steps at 4/s and half a second, at 30/s
    assert film.get(cv2.CAP_PROP_FPS) == 30
    assert pictures[0].shape[1] == 640
    moved = [int(np.abs(one.astype(int) - pictures[-1]).max()) for one in pictures]
    assert moved[0] > 40 > max(moved[-14:]), "the end is shown for half a second"
    page.evaluate("delete window.VideoEncoder")
    record.click()
    expect(page.get_by_text("There is no film: this browser does not encode films")).to_be_visible()


def test_cameras_show_colour_and_depth_of_the_env_step(site: SiteUnderTest, page: Page) -> None:
    open_player(site, page, made(site, FUSION, 7))
    pictures = [page.get_by_role("img", name=name) for name in ("camera, colour", "camera, depth")]
    before = [seen(picture) for picture in pictures]
    assert all(len(colours(picture)) > 4 for picture in pictures)
    expect_time(page, str(len(guided(FUSION, 7).rewards)))
    page.keyboard.press("Home")
    expect_time(page, "0")
    after = [seen(picture) for picture in pictures]
    assert all(one != other for one, other in zip(before, after, strict=True))


def test_scrubbing_moves_scene_flow_and_plots(site: SiteUnderTest, page: Page) -> None:
    open_player(site, page, made(site))
    scene, flow = page.locator("canvas.scene"), page.get_by_role("img", name="left sensor")
    cursor = page.locator("line.cursor").first
    before = seen(scene), flow.screenshot(), cursor.get_attribute("x1")
    page.get_by_label("Env step", exact=True).fill("2.5")
    expect(page.get_by_label("Env step", exact=True)).to_have_attribute("aria-valuetext", "env step 2.5 of 3")
    after = seen(scene), flow.screenshot(), cursor.get_attribute("x1")
    assert all(one != other for one, other in zip(before, after, strict=True))
    tints = [max(colour) - min(colour) for colour in colours(flow)]
    open_layers(page)
    page.get_by_label("Tactile pictures").uncheck()
    assert max(tints) > 2 > max(max(colour) - min(colour) for colour in colours(flow)), "arrows on grey"
    plot = page.get_by_role("img", name="Reward over the env steps")
    plot.click()  # its middle
    assert 1 < float(page.get_by_label("Env step", exact=True).input_value()) < 2


def test_playing_goes_to_the_end_at_the_chosen_speed_and_starts_again(site: SiteUnderTest, page: Page) -> None:
    page.clock.install(time=0)
    open_player(site, page, made(site))
    page.clock.pause_at(HOUR_S)
    play = page.locator("form.transport [name=play]")
    output = page.locator("form.transport output")
    open_layers(page)
    page.get_by_label("Speed").select_option("4")
    play.click()
    expect(page.get_by_label("Speed")).to_be_hidden()
    expect(play).to_have_text("Pause")
    page.clock.run_for(500)
    expect(output).to_have_text(re.compile(r"^(1\.9|2\.0) of 3"))
    page.clock.run_for(500)
    expect(play).to_have_text("Play")
    expect_time(page, "3")
    play.click()
    page.clock.run_for(100)
    expect(output).to_have_text(re.compile(r"^0\.[34] of 3"))


def test_the_keyboard_plays_moves_and_turns(site: SiteUnderTest, page: Page) -> None:
    page.clock.install(time=0)
    open_player(site, page, made(site))
    expect(page.get_by_text("With the scene focused")).to_be_visible()
    expect_time(page, "3")  # the end, which the still shows
    for key, time in (("Home", "0"), ("ArrowRight", "1"), ("End", "3"), ("ArrowLeft", "2"), ("Home", "0")):
        page.keyboard.press(key)
        expect_time(page, time)
    scene = page.locator("canvas.scene")
    scene.focus()
    before = seen(scene)
    for key in ("ArrowLeft", "ArrowUp", "+"):
        page.keyboard.press(key)
        after = seen(scene)
        assert after != before, key
        before = after
    expect_time(page, "0")
    scene.blur()
    page.clock.pause_at(HOUR_S)
    play = page.locator("form.transport [name=play]")
    page.keyboard.press("Space")
    expect(play).to_have_text("Pause")
    page.clock.run_for(1000)
    page.keyboard.press("Space")
    expect(play).to_have_text("Play")
    page.clock.run_for(1000)
    expect(page.locator("form.transport output")).to_have_text(re.compile(r"^(0\.9|1\.0) of 3"))


def test_the_scene_is_turned_by_the_pointer_cut_open_and_coloured_by_displacement_or_contact_pressure(
    site: SiteUnderTest, page: Page
) -> None:
    open_player(site, page, made(site))
    scene = page.locator("canvas.scene")
    pictures = [seen(scene)]
    box = scene.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 250, box["y"] + 120, steps=4)
    page.mouse.up()
    pictures.append(seen(scene))
    open_layers(page)
    page.get_by_label("Cut open").check()
    page.keyboard.press("Escape")
    pictures.append(seen(scene))
    assert len(set(pictures)) == 3
    page.keyboard.press("End")
    expect(page.get_by_text("Displacement: 0 to")).to_contain_text("mm")
    before = colours(scene)
    open_layers(page)
    page.get_by_label("Colours").select_option("pressure")
    page.keyboard.press("Escape")
    expect(page.get_by_text("Contact pressure: 0 to")).to_contain_text("kPa and above; on peg and plate: forces")
    assert colours(scene) != before


def test_a_section_has_the_colour_of_the_peg_and_a_gel_is_seen_through_it(site: SiteUnderTest, page: Page) -> None:
    open_player(site, page, made(site))
    scene = page.locator("canvas.scene")
    page.get_by_label("View").select_option("section")
    assert (13, 11, 8) in colours(scene)
    page.get_by_label("View").select_option("left")
    open_layers(page)
    through = seen(scene)
    page.get_by_label("X-ray").check()
    assert seen(scene) == through
    page.keyboard.press("Escape")
    page.get_by_label("View").select_option("section")
    assert (13, 11, 8) not in colours(scene)


def test_where_the_peg_presses_on_the_plate_both_are_coloured(site: SiteUnderTest, page: Page) -> None:
    def dark_red(place: Locator) -> int:
        red, green, blue = np.asarray(Image.open(io.BytesIO(seen(place))).convert("RGB")).transpose(2, 0, 1).astype(int)
        return int(((red > 90) & (green < 40) & (blue < 50)).sum())

    open_player(site, page, f"{made(site)}?step=0.9")
    scene = page.locator("canvas.scene")
    open_layers(page)
    page.get_by_label("Cut open").check()
    for covers in ("Forces", "Corner numbers"):
        page.get_by_label(covers).uncheck()
    assert dark_red(scene) == 0
    page.get_by_label("Colours").select_option("pressure")
    assert dark_red(scene) > 10, "beside the menu the scene is smaller"


def test_two_episodes_play_side_by_side(site: SiteUnderTest, page: Page) -> None:
    made(site, PEG, 6)
    open_player(site, page, made(site))
    page.get_by_label("Episode, 1 to").fill("6")
    page.get_by_role("button", name="Show").click()
    expect(page.locator("canvas.scene")).to_have_count(2)
    expect(page.get_by_role("form", name="Playback")).to_be_visible()
    left, right = page.locator(".player").all()
    one, other = page.locator(".measured").all()
    first, second = (player.bounding_box() for player in (left, right))
    assert first is not None
    assert second is not None
    assert second["x"] > first["x"] + first["width"] - 1
    before = [seen(player.locator("canvas.scene")) for player in (left, right)]
    page.keyboard.press("Home")
    after = [seen(player.locator("canvas.scene")) for player in (left, right)]
    assert all(one != other for one, other in zip(before, after, strict=True))
    expect(one.get_by_text("Displacement: 0 to")).to_have_text(other.get_by_text("Displacement: 0 to").inner_text())
    for part in ("canvas.scene", ".legend", ".story", ".panels", ".plots"):
        tops = {place["y"] for place in (found.bounding_box() for found in page.locator(part).all()) if place}
        assert len(tops) == 1, f"{part} of both stand side by side"
    assert violations(page) == []


def test_an_episode_fits_a_phone(site: SiteUnderTest, page: Page) -> None:
    resize(page, PHONE)
    open_player(site, page, made(site, FUSION, 7))
    wait_for_rest(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    schemes: tuple[Literal["light", "dark"], ...] = ("light", "dark")
    for scheme in schemes:
        page.emulate_media(color_scheme=scheme)
        assert violations(page) == []


def test_a_browser_without_webgl_shows_the_still_and_the_plots(site: SiteUnderTest, page: Page) -> None:
    page.add_init_script(NO_WEBGL)
    site.open(page, made(site))
    expect(page.get_by_text("This browser shows no WebGL")).to_be_visible()
    expect(page.locator("img.still")).to_be_visible()
    expect(page.locator("canvas.scene")).to_be_hidden()
    expect(page.get_by_role("img", name="over the env steps")).to_have_count(5)
    parts = [page.locator(part).bounding_box() for part in (".stage", ".transport", ".story", ".panels")]
    for above, below in pairwise(part for part in parts if part):
        assert 0 <= below["y"] - above["y"] - above["height"] < 40, "no gap where the scale of colours would stand"
    expect(page.get_by_text("Space plays and pauses")).to_be_visible()
    for without_effect in ("Displacement: 0 to", "With the scene focused"):
        expect(page.get_by_text(without_effect)).to_be_hidden()
    open_layers(page)
    expect(page.get_by_label("Speed")).to_be_visible()
    for without_effect in ("Colours", "Cut open"):
        expect(page.get_by_label(without_effect)).to_be_hidden()
    page.get_by_role("heading", level=1).click()
    page.keyboard.press("End")
    expect_time(page, "3")


def test_without_javascript_there_is_the_still_and_a_button_to_ask(browser: Browser, site: SiteUnderTest) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    site.enter(page)
    site.open(page, made(site, number=6))
    expect(page.locator("img.still")).to_be_visible()
    expect(page.locator("canvas.scene")).to_be_hidden()
    expect(page.get_by_text("Space plays and pauses")).to_be_hidden()
    site.open(page, not_made(site))
    page.get_by_role("button", name="Make the playback").click()
    expect(page.get_by_text("Another playback is made first")).to_be_visible()
    context.close()


def test_a_page_asks_by_itself_shows_progress_and_then_plays(site: SiteUnderTest, page: Page) -> None:
    site.open(page, not_made(site))
    expect(page.get_by_text("Another playback is made first")).to_be_visible()
    ask_for_playback(site.seeded, "both", state=WorkState.RUNNING, env_steps_played=2)
    expect(page.get_by_text("Being made: env step 2 of 4.")).to_be_visible()
    expect(page.get_by_role("progressbar")).to_have_attribute("value", "2")
    assert violations(page) == []
    made(site)
    expect(page.get_by_role("form", name="Playback")).to_be_visible()


@pytest.mark.parametrize(("status", "goes_on"), [(401, False), (404, False), (429, True), (503, True)])
def test_a_page_asks_again_only_where_the_answer_may_change(
    browser: Browser, site: SiteUnderTest, status: int, goes_on: bool
) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.clock.install()
    site.enter(page)
    path = not_made(site)
    asked: list[str] = []

    def refuse_once(route: Route) -> None:
        if route.request.method == "GET":
            asked.append(route.request.url)
        if route.request.method == "GET" and len(asked) == 1:
            route.fulfill(status=status, json={"detail": "Not now."})
        else:
            route.continue_()

    page.route("**/playback", refuse_once)
    site.open(page, path)
    if goes_on:
        expect(page.get_by_text("Another playback is made first")).to_be_visible()
        assert len(asked) > 1
    else:
        expect(page.get_by_text("Not now. Reload the page to go on.")).to_be_visible()
        page.clock.run_for(1500)  # ms, longer than the pause between two questions
        expect(page.get_by_text("Not now. Reload the page to go on.")).to_be_visible()
        assert len(asked) == 1
    context.close()


def test_a_page_whose_session_is_over_leads_to_the_sign_in(site: SiteUnderTest, page: Page) -> None:
    site.open(page, not_made(site))
    expect(page.get_by_text("Another playback is made first")).to_be_visible()
    page.context.clear_cookies()
    expect(page).to_have_url(re.compile("/sign-in"))


def test_a_failed_playback_says_so(site: SiteUnderTest, page: Page) -> None:
    site.open(page, not_made(site))
    expect(page.get_by_text("Another playback is made first")).to_be_visible()
    ask_for_playback(site.seeded, "both", state=WorkState.FAILED)
    expect(page.get_by_text("There is no playback of this episode. The states differ.")).to_be_visible()
    expect(page.get_by_text("With the scene focused")).to_be_hidden()  # the player's help
    assert violations(page) == []


def test_a_server_that_is_gone_is_said(browser: Browser, site: SiteUnderTest) -> None:
    context = browser.new_context()
    page = context.new_page()
    site.enter(page)
    path = not_made(site)
    page.route("**/playback", lambda route: route.abort())
    site.open(page, path)
    expect(page.get_by_text("The server cannot be reached.")).to_be_visible()
    context.close()


def test_a_file_that_was_lost_is_said(browser: Browser, site: SiteUnderTest) -> None:
    context = browser.new_context()
    page = context.new_page()
    site.enter(page)
    path = made(site)
    shutil.rmtree(site.seeded.services.settings.state_dir / "blobs")
    site.open(page, path)
    expect(page.get_by_text("The playback cannot be shown:")).to_contain_text("got status 404")
    context.close()


def test_one_playback_too_many_is_said(browser: Browser, site: SiteUnderTest) -> None:
    context = browser.new_context()
    page = context.new_page()
    site.enter(page)
    team = site.seeded.visitor(GELBOTS)
    for number in range(11, 11 + site.seeded.services.settings.playbacks_at_once):
        path = path_of_episode(site.seeded, "both", number)
        assert team.post(f"{path}/playback", data={"form_token": form_token(team)}).status_code == 303
    site.open(page, path_of_episode(site.seeded, "both"))
    expect(page.get_by_text("playbacks that wait or are being made are possible")).to_be_visible()
    context.close()


def test_a_cell_of_the_map_leads_to_its_episode(site: SiteUnderTest, page: Page) -> None:
    path = made(site)
    site.open(page, site.path_of("both"))
    assert violations(page) == []
    page.locator(f'svg.map a[href="{path}"]').click()
    expect(page.get_by_role("heading", level=1)).to_have_text("Peg insertion, episode 5")


def test_the_keyboard_moves_in_a_map_by_arrows_and_leaves_it_by_tab(site: SiteUnderTest, page: Page) -> None:
    site.open(page, site.path_of("both"))
    first = page.locator("svg.map").first.locator("a").first
    first.focus()
    start = first.get_attribute("href")
    focused = page.locator("svg.map a:focus")

    def press(key: str, *others: str | None) -> str | None:
        """Presses a key and returns where the focus has gone, which is none of the others."""
        page.keyboard.press(key)
        return until(page, lambda: focused.get_attribute("href"), lambda href: href not in others)

    right = press("ArrowRight", start)
    press("ArrowDown", start, right)
    page.keyboard.press("ArrowUp")
    expect(focused).to_have_attribute("href", right or "")
    page.keyboard.press("Tab")
    expect(page.locator("svg.map").nth(1).locator("a:focus")).to_have_count(1)


def test_focus_in_a_map_outlives_an_update(site: SiteUnderTest, page: Page) -> None:
    site.open(page, site.path_of("runs"))
    link = page.locator("svg.map a").first
    link.focus()
    href = link.get_attribute("href")
    site.seeded.play_on("runs")
    expect(page.get_by_text("138 of 270")).to_be_visible()
    expect(page.locator("svg.map a:focus")).to_have_attribute("href", href or "")


def test_the_front_page_plays_its_episode_by_itself(page: Page, site: SiteUnderTest) -> None:
    page.add_init_script(
        """globalThis.times = [];
        const output = "form.transport output";
        const noted = ({ target, addedNodes: [text] }) => target.matches?.(output) && times.push(text.textContent);
        const observer = new MutationObserver((changes) => changes.forEach(noted));
        observer.observe(document, { childList: true, subtree: true });"""
    )
    site.open(page, "/")
    expect(page.get_by_role("button", name="Play it in 3D")).to_have_count(0)
    # The player opens at the end. A busy machine may draw no more than the first and the last of the three seconds.
    ends = partial(page.evaluate, "times.filter((time) => /^[03]\\.0/.test(time))")
    until(page, ends, lambda times: times[-3:] == ["3.0 of 3", "0.0 of 3", "3.0 of 3"])


def test_the_front_page_moves_only_on_request_for_readers_who_want_no_motion(page: Page, site: SiteUnderTest) -> None:
    page.emulate_media(reduced_motion="reduce")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    site.open(page, "/")
    expect(page.locator("img.still")).to_have_js_property("complete", value=True)
    page.evaluate("new Promise(requestIdleCallback)")
    assert asked
    assert not any("playback" in url for url in asked)
    page.get_by_role("button", name="Play it in 3D").click()
    expect(page.locator("canvas.scene")).to_be_visible()
    expect(page.locator("form.transport [name=play]")).to_be_focused()
    expect(page.get_by_role("button", name="Play it in 3D")).to_have_count(0)
    expect(page.locator("form.transport output")).not_to_have_text(re.compile(r"^0\.0 of"))
    assert violations(page) == []


def test_an_embedded_episode_is_accessible(site: SiteUnderTest, page: Page) -> None:
    path = made(site)
    site.seeded.publish("both")
    site.open(page, f"/embed{path}")
    expect(page.get_by_role("form", name="Playback")).to_be_visible()
    assert violations(page) == []
