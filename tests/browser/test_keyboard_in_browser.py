"""The pages by keyboard alone: everything is reached and seen, nothing holds the focus, and forms do their work."""

import re
from typing import Any

import pytest
from browser_checks import DESK, PHONE
from page_fixtures import TASK
from playwright.sync_api import Page, expect
from site_under_test import SiteUnderTest
from waiting import resize

STOPS = """() => {
    const isStop = (one) => one.tabIndex >= 0 && !one.disabled && one.checkVisibility({ visibilityProperty: true });
    const kinds = "a[href], button, input:not([type=hidden]), select, textarea, summary, [tabindex]";
    const stops = [...document.querySelectorAll(kinds)].filter(isStop);
    const name = (one) => one.outerHTML.slice(0, 120);
    const met = new Set(), hidden = [];
    document.addEventListener("focusin", ({ target }) => {
        met.add(target);
        const place = target.getBoundingClientRect(), style = getComputedStyle(target);
        const isRinged = style.outlineStyle === "solid" && parseFloat(style.outlineWidth) >= 2;
        if (!isRinged || place.bottom <= 0 || place.top >= innerHeight) hidden.push(name(target));
    });
    window.stops = { count: stops.length, left: () => stops.filter((one) => !met.has(one)).map(name), hidden };
    return stops.length;
}"""


def press_tab_through(page: Page) -> Any:
    """Presses Tab once for each stop of a page and returns those that were not reached, or had no focus to see."""
    stops = page.evaluate(STOPS)
    assert stops > 3
    for _ in range(stops):
        page.keyboard.press("Tab")
    return page.evaluate("({ left: stops.left(), hidden: stops.hidden })")


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_tab_reaches_everything_in_sight_and_is_held_nowhere(
    page: Page, site: SiteUnderTest, size: dict[str, int]
) -> None:
    page.emulate_media(reduced_motion="reduce")
    resize(page, size)
    site.enter(page)
    pages = ("/", "/tracks/track_1", "/tracks/track_1/rules", site.path_of("done"), "/submissions/upload", "/docs/")
    for path in pages:
        site.open(page, path)
        assert press_tab_through(page) == {"left": [], "hidden": []}, path


def test_results_are_marked_and_compared(page: Page, site: SiteUnderTest) -> None:
    site.enter(page)
    site.open(page, f"/tracks/track_1?task={TASK}")
    for name in ("Compare Tactile Bears", "Compare Gelbots"):
        page.get_by_role("checkbox", name=name).focus()
        page.keyboard.press("Space")
    page.get_by_role("button", name="Compare the marked rows").focus()
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile(r"/compare\?id=[0-9a-f-]+&id=[0-9a-f-]+$"))


def test_a_fold_opens_and_its_links_lead_on(page: Page, site: SiteUnderTest) -> None:
    site.open(page, "/tracks/track_1")
    page.get_by_text("How this board was made").focus()
    page.keyboard.press("Enter")
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="CSV")).to_be_focused()


def test_a_board_is_searched(page: Page, site: SiteUnderTest) -> None:
    site.open(page, "/tracks/track_1?q=nobody")
    expect(page.get_by_role("status")).to_contain_text("None of 4 teams are shown")
    page.get_by_label("Team", exact=True).fill("bears")
    page.keyboard.press("Enter")
    expect(page.get_by_role("status")).to_contain_text("1 of 4 teams is shown")
    expect(page.get_by_role("rowheader", name="Tactile Bears")).to_be_visible()
