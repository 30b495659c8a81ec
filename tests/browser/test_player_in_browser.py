"""What the 3D player spends: when it draws, how sharply, and what it sends to the graphics card."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_checks import DESK
from played_episodes import ask_for_playback, guided
from playwright.sync_api import Browser, Page, expect
from real_browser import SOFTWARE_WEBGL, launched
from site_under_test import served_site
from tab_key import press_tab_through
from vitac.envs.tactile.camera import camera_frame
from vitac.envs.tactile.gel import eye_distance_m
from vitac.envs.vision.tactile_picture import TactileCamera
from vitac.server.database.states import WorkState
from waiting import LIMIT_S, PIXELS_AT_REST, resize, until, wait_for_rest

pytestmark = pytest.mark.slow

COUNTED = """
    window.counted = { pictures: 0, uploads: 0 };
    const { clear, bufferSubData } = WebGL2RenderingContext.prototype;
    Object.assign(WebGL2RenderingContext.prototype, {
      clear(...given) {  // a shadow is drawn into a buffer of its own
        counted.pictures += this.getParameter(this.FRAMEBUFFER_BINDING) === null;
        return clear.apply(this, given);
      },
      bufferSubData(...given) { counted.uploads += 1; return bufferSubData.apply(this, given); },
    });
"""
SIZES = """() => {
    const scene = document.querySelector("canvas.scene");
    const [seen, room] = [scene, scene.parentElement].map((one) => one.getBoundingClientRect());
    return { seen: [seen.width, seen.height], drawn: [scene.width, scene.height], room: [room.width, room.height] };
}"""
AFTER_TWO_FRAMES = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done({...counted}))))"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with launched(*SOFTWARE_WEBGL) as browser:
        yield browser


@pytest.fixture(scope="module")
def opened_page(browser: Browser) -> Iterator[Page]:
    """The page of an episode, which counts what it draws and sends."""
    with served_site() as site:
        context = browser.new_context(viewport=DESK)  # type: ignore[arg-type]
        page = context.new_page()
        page.add_init_script(COUNTED)
        site.enter(page)
        site.open(page, ask_for_playback(site.seeded, "both", state=WorkState.DONE))
        expect(page.get_by_role("form", name="Playback")).to_be_visible()
        yield page
        context.close()


@pytest.fixture
def still_page(opened_page: Page) -> Page:
    """That page, whose scene has come to rest wherever the last test left it."""
    opened_page.emulate_media(reduced_motion="no-preference")
    resize(opened_page, DESK)
    wait_for_rest(opened_page)
    return opened_page


def counted(page: Page) -> dict[str, int]:
    found: dict[str, int] = page.evaluate(AFTER_TWO_FRAMES)
    return found


def test_tab_reaches_scene_and_controls_and_none_covers_another(still_page: Page) -> None:
    assert press_tab_through(still_page) == {"left": [], "hidden": []}


def test_a_scene_is_drawn_once_for_what_changes_between_two_frames_and_not_while_it_rests(still_page: Page) -> None:
    drawn = still_page.evaluate(
        """async () => {
            const before = counted.pictures;
            const controls = document.querySelector("form.transport").elements;
            for (const name of ["forward", "back", "forward", "back"]) controls[name].click();
            await new Promise(requestAnimationFrame);  // asked for after the page's own, so it comes after that
            return counted.pictures - before;
        }"""
    )
    assert drawn == 1
    wait_for_rest(still_page)
    rested = counted(still_page)["pictures"]
    still_page.wait_for_timeout(400)
    assert counted(still_page)["pictures"] == rested


def test_a_moment_of_the_episode_is_sent_to_the_graphics_card_once(still_page: Page) -> None:
    page = still_page
    sent = []
    for time in ("1.0001", "1.0002", "1.0003"):  # between the same two moments
        page.get_by_label("Env step", exact=True).fill(time)
        sent.append(counted(page)["uploads"])
    assert sent[0] > 0
    assert sent == [sent[0]] * 3
    page.get_by_label("Env step", exact=True).fill("2.5")
    assert counted(page)["uploads"] > sent[0]


def test_a_scene_in_motion_is_drawn_less_sharply_and_in_full_once_it_rests(still_page: Page) -> None:
    found = still_page.evaluate(
        """async (full) => {
            const { speed, play, time } = document.querySelector("form.transport").elements;
            const scene = document.querySelector("canvas.scene");
            const look = () => ({ time: Number(time.value), pixels: scene.width / scene.clientWidth });
            speed.value = 0.25;
            play.click();
            let found = look();
            for (let frames = 0; frames < 100 && !(found.time > 0 && found.pixels < full); frames += 1) {
              await new Promise(requestAnimationFrame);
              found = look();
            }
            play.click();
            return found;
        }""",
        0.99 * PIXELS_AT_REST,
    )
    assert found["time"] > 0
    assert found["pixels"] < 0.99 * PIXELS_AT_REST
    wait_for_rest(still_page)
    assert float(still_page.get_by_label("Env step", exact=True).input_value()) >= found["time"]


def test_the_camera_flies_to_a_view_and_is_there_at_once_where_no_motion_is_wanted(still_page: Page) -> None:
    drawn = {}
    for motion, view in (("no-preference", "above"), ("reduce", "left")):
        still_page.emulate_media(reduced_motion=motion)  # type: ignore[arg-type]
        before = counted(still_page)["pictures"]
        still_page.get_by_label("View").select_option(view)
        wait_for_rest(still_page)
        drawn[motion] = counted(still_page)["pictures"] - before
    assert drawn["reduce"] <= 2 < drawn["no-preference"], "one in motion, and one in full resolution"


def test_a_scene_covers_whole_pixels_of_the_page_so_that_its_lines_are_unbroken(still_page: Page) -> None:
    def is_covered(found: dict[str, list[float]]) -> bool:
        seen, drawn, room = (found[name] for name in ("seen", "drawn", "room"))
        return drawn == [PIXELS_AT_REST * length for length in seen] and all(
            0 <= space - length <= 3 for length, space in zip(seen, room, strict=True)
        )

    rooms = []
    for width in (DESK["width"], 903):
        resize(still_page, {**DESK, "width": width})
        rooms.append(until(still_page, lambda: still_page.evaluate(SIZES), is_covered)["room"])
    assert rooms[0] != rooms[1]


def test_a_scene_at_rest_is_drawn_again_after_the_graphics_card_was_lost(still_page: Page) -> None:
    before = counted(still_page)["pictures"]
    still_page.evaluate(
        """(limitMs) => new Promise((done, fail) => {
            const scene = document.querySelector("canvas.scene");
            const card = scene.getContext("webgl2").getExtension("WEBGL_lose_context");
            scene.addEventListener("webglcontextrestored", done);
            scene.addEventListener("webglcontextlost", () => setTimeout(() => card.restoreContext()));
            card.loseContext();
            setTimeout(() => fail(new Error("the card did not come back")), limitMs);
        })""",
        1000 * LIMIT_S,
    )
    wait_for_rest(still_page)
    assert counted(still_page)["pictures"] > before


PARTS = """async ([source, intervals]) => {
    const address = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
    const { Resolution } = await import(address);
    const resolution = new Resolution();
    return intervals.map((interval) => {
      if (interval === null) resolution.rest();
      else resolution.took(interval);
      return resolution.part;
    });
}"""


@pytest.fixture(scope="module")
def empty_page(browser: Browser) -> Iterator[Page]:
    page = browser.new_page()
    yield page
    page.close()


def test_a_state_that_never_comes_fails_with_what_was_seen(empty_page: Page) -> None:
    with pytest.raises(AssertionError, match=r"expected another state within 0\.1 s, got 1"):
        until(empty_page, lambda: 1, lambda seen: seen < 0, limit_s=0.1)


def parts(page: Page, repository: Path, *intervals: float | None) -> list[float]:
    """What part of the full resolution is drawn after each frame that took so long [ms]; None: it stood still."""
    source = (repository / "viewer" / "resolution.js").read_text(encoding="utf-8")
    found: list[float] = page.evaluate(PARTS, [source, list(intervals)])
    return found


def test_slow_frames_are_drawn_with_fewer_pixels_until_they_come_in_time(empty_page: Page, repository: Path) -> None:
    first, slow, slower, in_time = (parts(empty_page, repository, *steps)[-1] for steps in (
        [16.7], [24.0] * 6, [24.0] * 6 + [20.0] * 6, [24.0] * 6 + [20.0] * 6 + [16.7] * 12,
    ))  # fmt: skip
    assert first > slow > slower == in_time > 0


def test_a_scene_never_has_less_than_three_quarters_of_the_pages_pixels(empty_page: Page, repository: Path) -> None:
    falling = [400.0 * 0.8**number for number in range(12) for _ in range(6)]
    assert PIXELS_AT_REST * min(parts(empty_page, repository, *falling)) == pytest.approx(0.75)


def test_one_slow_frame_changes_nothing(empty_page: Page, repository: Path) -> None:
    assert len(set(parts(empty_page, repository, *([16.7] * 5 + [400.0]) * 3))) == 1


def test_pixels_that_are_no_help_are_given_back(empty_page: Page, repository: Path) -> None:
    found = parts(empty_page, repository, *[33.3] * 60)
    assert min(found) < found[0]
    assert found[-1] == found[0]
    assert len(set(found[12:])) == 1, "not tried again and again"


def test_short_motions_on_a_slow_screen_leave_the_resolution_as_it_was(empty_page: Page, repository: Path) -> None:
    found = parts(empty_page, repository, *([33.3] * 7 + [None]) * 6, *[33.3] * 60)
    assert found[7::8][:6] == [found[0]] * 6
    assert found[-1] == found[0]


def test_a_machine_that_was_busy_now_and_then_draws_in_full_again_within_a_minute(
    empty_page: Page, repository: Path
) -> None:
    busy = ([16.7] * 6 * 100 + [30.0] * 6 + [None]) * 10
    assert parts(empty_page, repository, *busy, *[16.7] * 60 * 60)[-1] == 1


def test_a_fast_machine_draws_in_full(empty_page: Page, repository: Path) -> None:
    found = parts(empty_page, repository, *[8.3] * 200)
    assert found == sorted(found)
    assert found[-1] == 1


def test_a_rise_that_was_too_much_is_not_tried_soon(empty_page: Page, repository: Path) -> None:
    def rises(*more: float) -> int:
        found = parts(empty_page, repository, *[16.7] * 30, *more)
        return sum(one < other for one, other in pairwise(found))

    again = [16.7] * 30
    assert rises() == 1
    assert rises(*again) == 2
    assert rises(*[30.0] * 6, *again) == 1
    assert rises(*[30.0] * 6, *again, *again) == 2


def test_a_rest_forgets_how_long_frames_took(empty_page: Page, repository: Path) -> None:
    steps: list[Any] = [*[40.0] * 5, None]
    assert len(set(parts(empty_page, repository, *steps * 4))) == 1


TAKEN = """async ([source, nodes, triangles, ...seen]) => {
    const { TactileCamera } = await import(URL.createObjectURL(new Blob([source], { type: "text/javascript" })));
    const camera = new TactileCamera(new Float32Array(nodes), new Uint16Array(triangles));
    return Array.from(camera.picture(...seen));
}"""


@pytest.mark.parametrize("side", [0, 1])
def test_the_player_sees_a_gel_as_the_renderer_of_observations_does(
    empty_page: Page, repository: Path, side: int
) -> None:
    played = guided("peg-insertion", 5)
    gel, moment = played.gel, played.moments[played.last_moments[1]]
    pose, markers = moment.sensor_poses[side], moment.marker_flow[side, 1].astype(np.float64)
    eye_m = eye_distance_m(gel)
    gel_m, held_m = (
        camera_frame(points_m, pose.rotation, pose.centre_m, eye_m)
        for points_m in (moment.gel_nodes_m[side], moment.held_m)
    )
    expected = TactileCamera(gel, played.camera).picture(gel_m, held_m, played.held.triangles, markers)
    surface = np.unique(gel.surface_triangles)
    in_gel_mm = [
        1e3 * (points_m - pose.centre_m) @ pose.rotation
        for points_m in (moment.gel_nodes_m[side][surface], moment.held_m)
    ]
    rest_mm = 1e3 * gel.rest_position_m[surface]
    moved_mm = (in_gel_mm[0] - rest_mm).round(3)  # as files have it
    arrays = (
        rest_mm,
        np.searchsorted(surface, gel.surface_triangles),
        moved_mm,
        in_gel_mm[1],
        played.held.triangles,
        markers,
    )
    source = (repository / "viewer" / "tactile.js").read_text(encoding="utf-8")
    found = empty_page.evaluate(TAKEN, [source, *(array.ravel().tolist() for array in arrays)])
    shown = np.array(found).reshape(*expected.shape[:2], 4)[:, :, 2::-1]
    assert np.abs(shown - expected.astype(np.int64)).max() <= 2
    untouched = TactileCamera(gel, played.camera).picture(
        camera_frame(gel.rest_position_m, np.eye(3), np.zeros(3), eye_m),
        np.zeros((0, 3)),
        played.held.triangles[:0],
        markers,
    )
    assert np.abs(shown - untouched.astype(np.int64)).max() > 10, "it shows how the gel is deformed"
