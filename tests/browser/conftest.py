"""A real browser (Debian's chromium, driven by playwright) and a service with content on this machine."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect
from real_browser import WITHOUT_GPU, launched
from site_under_test import SiteUnderTest, served_site
from waiting import LIMIT_S

expect.set_options(timeout=1000 * LIMIT_S)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    # Not for the whole session: playwright keeps an event loop in this thread, which other tests must not find running.
    with launched(*WITHOUT_GPU) as browser:
        yield browser


@pytest.fixture
def site() -> Iterator[SiteUnderTest]:
    with served_site() as site:
        yield site


@pytest.fixture
def page(browser: Browser, site: SiteUnderTest) -> Iterator[Page]:
    """A page, closed before the site ends, which would wait two seconds for its stream of events."""
    context = browser.new_context()
    yield context.new_page()
    context.close()
