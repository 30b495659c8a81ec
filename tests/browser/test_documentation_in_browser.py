"""The documentation site as the service serves it: it works under its policy, is accessible, and its search finds."""

import subprocess
from pathlib import Path

import pytest
from browser_checks import DESK, PHONE, Complaints, violations
from playwright.sync_api import Browser, expect
from site_under_test import SiteUnderTest
from vitac.web.pages.documentation import SITE

PAGES = ("", "start/participant.html", "failures.html", "reference/rest.html", "reference/environments.html")


# What `./vitac serve` does before it starts.
BUILD = "root=$PWD; for part in report python docs; do . setup/$part.sh; done; ensure_docs"


@pytest.fixture(scope="module", autouse=True)
def _is_built(repository: Path) -> None:
    """Builds it here, where it is needed: other tests then do not wait for it after each change of the API."""
    built = subprocess.run(["sh", "-euc", BUILD], cwd=repository, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    assert (SITE / "index.html").is_file()


@pytest.mark.parametrize(("scheme", "size"), [("light", DESK), ("dark", PHONE)], ids=["light desk", "dark phone"])
def test_documentation_is_accessible_and_raises_no_error(
    browser: Browser, site: SiteUnderTest, scheme: str, size: dict[str, int]
) -> None:
    context = browser.new_context(viewport=size, color_scheme=scheme)  # type: ignore[arg-type]
    page = context.new_page()
    complaints = Complaints(page)
    for path in PAGES:
        page.goto(f"{site.address}/docs/{path}")
        expect(page.get_by_role("heading", level=1)).to_be_visible()
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"], f"{path} scrolls sideways"
        assert violations(page) == [], path
    assert complaints.heard == []
    context.close()


def test_search_finds_a_page(browser: Browser, site: SiteUnderTest) -> None:
    page = browser.new_page()
    page.goto(f"{site.address}/docs/")
    page.get_by_placeholder("Search").fill("Wilson interval")
    page.keyboard.press("Enter")
    expect(page.locator("#search-results li a").first).to_be_visible()
    page.close()
