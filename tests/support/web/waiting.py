"""Waits for the state that a test asserts: a time that is enough on one machine is too short on another."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from playwright.sync_api import Page

LIMIT_S = 60.0
PAUSE_MS = 50.0
PIXELS_AT_REST = 2
"""Drawn for one of the page's, across; a scene in motion is drawn with fewer."""
REST = """async ([pixels, limitMs]) => {
    const frame = () => new Promise(requestAnimationFrame);
    const scenes = () => [...document.querySelectorAll("canvas.scene:not([hidden])")];
    const drawn = () => scenes().map((scene) => scene.width / scene.clientWidth);
    const rests = () => scenes().length && drawn().every((found) => Math.abs(found - pixels) < 0.01);
    const rest = async () => {
      for (let count = 0; count < 3; count += 1) await frame();  // what was changed until now is drawn
      while (!rests()) await frame();
    };
    const late = () => new Error(`expected ${pixels} pixels for one of the page's in each scene, got [${drawn()}]`);
    await Promise.race([rest(), new Promise((_, fail) => setTimeout(() => fail(late()), limitMs))]);
}"""

Seen = TypeVar("Seen")


def until(
    page: Page, look: Callable[[], Seen], holds: Callable[[Seen], object] = bool, *, limit_s: float = LIMIT_S
) -> Seen:
    """Look again and again until what is seen holds, and return it; the page's events are served meanwhile.

    Raises:
        AssertionError: It did not hold in time; says what was seen last.
    """
    for _ in range(max(1, round(1000 * limit_s / PAUSE_MS))):
        found = look()
        if holds(found):
            return found
        page.wait_for_timeout(PAUSE_MS)
    raise AssertionError(f"expected another state within {limit_s:g} s, got {found!r}")


def wait_for_rest(page: Page) -> None:
    """Wait until all scenes are drawn in full as they are now.

    Sleeps in the page itself, whose policy forbids playwright's own wait for a condition.
    """
    page.evaluate(REST, [PIXELS_AT_REST, 1000 * LIMIT_S])


def resize(page: Page, size: dict[str, int]) -> None:
    """Give the window a size [px] and wait until the page has it."""
    page.set_viewport_size({"width": size["width"], "height": size["height"]})
    wanted = [size["width"], size["height"]]
    until(page, lambda: page.evaluate("[innerWidth, innerHeight]"), lambda found: found == wanted)


@contextmanager
def answered(page: Page) -> Iterator[None]:
    """Wait until the answer to a form that is sent inside is the page, though its address may be the same."""
    with page.expect_navigation(timeout=1000 * LIMIT_S):
        yield
