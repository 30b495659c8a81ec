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
    expect(where).to_contain_text("env step 2 of 50")
    playing.keyboard.up("ArrowLeft")
    playing.keyboard.down("Shift")
    playing.keyboard.press("ArrowDown", delay=20)  # often while an env step is played
    playing.keyboard.up("Shift")
    expect(where).to_contain_text(", 0, 0.25.")  # a quarter of 1 mm
    found = re.search(r"env step (\d+) of 50, moved (\d+),", where.inner_text())
    assert found
    assert int(found[2]) == 2 * (int(found[1]) - 1) >= 4
    expect(playing.locator("#scene")).to_be_hidden()
    playing.get_by_label("Show the scene").check()
    expect(playing.locator("#scene")).to_be_visible()


def test_the_end_is_said_and_the_next_episode_begins(playing: Page) -> None:
    expect(playing.locator("#where")).to_contain_text("env step 0")
    playing.keyboard.down("ArrowRight")
    expect(playing.locator("#end")).to_contain_text("moved too far")
    playing.keyboard.up("ArrowRight")
    playing.get_by_role("button", name="Next episode").click()
    expect(playing.locator("#where")).to_contain_text("Episode 2, env step 0 of 50")
    expect(playing.locator("#where")).to_contain_text("0 of 1 solved")
