"""`vitac play` with a real keyboard: keys move the gripper, an episode ends, the scene is shown where asked for."""

import re
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect
from vitac.cli.play.server import PlayServer
from vitac.training.demonstrations.hand_play import HandPlay


@pytest.fixture
def played(tmp_path: Path) -> HandPlay:
    return HandPlay("lock-opening", tmp_path)


@pytest.fixture
def playing(browser: Browser, played: HandPlay) -> Iterator[Page]:
    with played.storing(), PlayServer(played) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        context = browser.new_context()
        page = context.new_page()
        faults: list[str] = []
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.goto(server.address)
        yield page
        context.close()
        server.shutdown()
        thread.join()
        assert faults == []


def test_keys_drive_the_gripper_while_they_are_held(playing: Page) -> None:
    where = playing.locator("#where")
    expect(where).to_contain_text("Episode 1, env step 0 of 50")
    expect(playing.locator("#keys dt")).to_have_text(["→ ← x", "↑ ↓ z"])
    assert playing.evaluate(
        "document.querySelector('canvas').getContext('2d').getImageData(0,0,640,480).data.some(Boolean)"
    )
    playing.keyboard.down("ArrowLeft")
    expect(where).to_contain_text(re.compile(r"env step ([2-9]|\d\d) of 50, moved \d+, 0, 0\."))
    playing.keyboard.up("ArrowLeft")
    expect(playing.locator("#scene")).to_be_hidden()
    playing.get_by_label("Show the scene").check()
    expect(playing.locator("#scene")).to_be_visible()


def test_a_short_press_is_an_env_step_also_while_another_one_is_played(playing: Page) -> None:
    expect(playing.locator("#where")).to_contain_text("env step 0")
    playing.evaluate("(() => { const send = fetch; fetch = async (...all) => "
                     "{ await new Promise((then) => setTimeout(then, 500)); return send(...all); }; })()")  # fmt: skip
    playing.keyboard.press("ArrowLeft", delay=20)
    playing.keyboard.down("Shift")
    playing.keyboard.press("ArrowDown", delay=20)
    playing.keyboard.up("Shift")
    expect(playing.locator("#where")).to_contain_text("env step 2 of 50, moved 2, 0, 0.25.")  # a quarter of 1 mm
    playing.keyboard.press("ArrowLeft", delay=20)
    playing.keyboard.press("ArrowDown", delay=20)
    playing.keyboard.press("Shift", delay=20)
    expect(playing.locator("#where")).to_contain_text("env step 4 of 50, moved 4, 0, 1.25.")  # it was not held yet


def test_the_end_is_said_and_the_next_episode_begins(playing: Page) -> None:
    expect(playing.locator("#where")).to_contain_text("env step 0")
    playing.keyboard.down("ArrowRight")
    expect(playing.locator("#end")).to_contain_text("moved too far")
    playing.keyboard.up("ArrowRight")
    playing.get_by_role("button", name="Next episode").click()
    expect(playing.locator("#where")).to_contain_text("Episode 2, env step 0 of 50")
    expect(playing.locator("#where")).to_contain_text("0 of 1 solved")


def next_step(playing: Page) -> str:
    where = playing.locator("#where")
    before = where.inner_text()
    expect(where).not_to_have_text(before)
    return where.inner_text()


def test_the_sticks_of_a_game_pad_drive_the_gripper_and_its_first_button_plays_without_motion(playing: Page) -> None:
    expect(playing.locator("#where")).to_contain_text("env step 0 of 50")
    # The left stick rests a little aside, which moves nothing along x, and is pushed up by half, as half an ArrowUp.
    playing.evaluate("window.pad = { connected: true, axes: [0.1, -0.5, 0, 0], buttons: [{ pressed: false }] };"
                     "navigator.getGamepads = () => [null, window.pad]")  # fmt: skip
    found = re.search(r"env step (\d+) of 50, moved 0, 0, (-[\d.]+)\. ", next_step(playing))
    assert found
    assert float(found[2]) == -0.5 * int(found[1])
    playing.evaluate("window.pad = { connected: true, axes: [0, 0, 0, 0], buttons: [{ pressed: true }] }")
    next_step(playing)  # perhaps one that had begun before
    first, second = next_step(playing), next_step(playing)
    assert first != second
    assert first.partition("moved")[2] == second.partition("moved")[2]
