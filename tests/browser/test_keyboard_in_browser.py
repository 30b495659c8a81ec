"""The pages by keyboard alone: everything is reached and seen, nothing holds the focus, and forms do their work."""

import re

import pytest
from browser_checks import DESK, PHONE
from playwright.sync_api import Page, expect
from service_factories import TASK
from site_under_test import SiteUnderTest
from tab_key import press_tab_through
from waiting import resize

pytestmark = pytest.mark.slow


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
    for name in ("Compare Bears", "Compare Gelbots"):
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
    expect(page.get_by_role("status")).to_contain_text("with “nobody” in the name: none of 2.")
    page.get_by_label("Team", exact=True).fill("bears")
    page.keyboard.press("Enter")
    expect(page.get_by_role("status")).to_contain_text("with “bears” in the name: 1 of 2.")
    expect(page.get_by_role("rowheader", name="Bears")).to_be_visible()
