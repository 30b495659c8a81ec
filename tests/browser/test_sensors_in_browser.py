import io
from collections.abc import Iterator

import pytest
from browser_checks import DESK, PHONE, violations
from PIL import Image
from playwright.sync_api import Browser, Locator, Page, expect
from real_browser import NO_WEBGL, SOFTWARE_WEBGL, launched
from seeded_site import GELBOTS
from shown_sensors import play_and_measure, upload_sensor
from site_under_test import SiteUnderTest
from waiting import resize, wait_for_rest

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """A browser that renders WebGL in software."""
    with launched(*SOFTWARE_WEBGL) as browser:
        yield browser


@pytest.fixture
def page(browser: Browser, site: SiteUnderTest) -> Iterator[Page]:
    """A page of somebody who is signed in, with two sensors to look at; it may complain of nothing."""
    for name in ("ridge", "dome"):
        upload_sensor(site.seeded, GELBOTS, name, name)
        play_and_measure(site.seeded, name)
    context = browser.new_context(viewport=DESK)  # type: ignore[arg-type]
    page = context.new_page()
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    site.enter(page)
    yield page
    assert complaints == []
    context.close()


def address(site: SiteUnderTest, *, beside: bool = False) -> str:
    return f"{site.path_of('ridge')}/sensor" + (f"?beside={site.seeded.id_of('dome')}" if beside else "")


def picture(canvas: Locator) -> Image.Image:
    wait_for_rest(canvas.page)
    return Image.open(io.BytesIO(canvas.screenshot())).convert("RGB")


def test_gels_are_turned_by_keys_fit_a_phone_and_nothing_is_against_accessibility(
    page: Page, site: SiteUnderTest
) -> None:
    site.open(page, address(site, beside=True))
    canvases = page.locator("canvas.scene")
    expect(canvases).to_have_count(2)
    expect(page.locator(".still:visible")).to_have_count(0)
    before = picture(canvases.first)
    assert len(before.getcolors(2**20) or ()) > 50
    canvases.first.focus()
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    assert picture(canvases.first).tobytes() != before.tobytes()
    assert violations(page) == []
    resize(page, PHONE)
    wait_for_rest(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]


def test_gel_is_a_still_drawing_without_webgl(page: Page, site: SiteUnderTest) -> None:
    page.add_init_script(NO_WEBGL)
    site.open(page, address(site))
    expect(page.locator(".player-status").first).to_contain_text("no WebGL")
    expect(page.locator("svg.still polygon").first).to_be_visible()
    expect(page.locator("canvas.scene").first).to_be_hidden()
