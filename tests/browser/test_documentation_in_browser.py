"""The documentation in a real browser; test_pages_in_browser looks at its pages for barriers, as at all others."""

import pytest
from playwright.sync_api import Browser, expect
from site_under_test import SiteUnderTest


@pytest.mark.slow
def test_search_leads_to_a_section(browser: Browser, site: SiteUnderTest) -> None:
    page = browser.new_page()
    page.goto(f"{site.address}/docs/")
    page.get_by_role("searchbox").fill("Wilson interval")
    page.keyboard.press("Enter")
    page.get_by_role("link", name="wilson_interval").click()
    expect(page.get_by_role("heading", name="wilson_interval")).to_be_in_viewport()
    page.close()
