"""The documentation site as the service serves it: it works under its policy, is accessible, and its search finds."""

import subprocess
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from browser_checks import DESK, PHONE, Complaints, violations
from playwright.sync_api import Browser, expect
from site_under_test import SiteUnderTest
from vitac.web.pages.documentation import SITE

pytestmark = pytest.mark.slow

TUTORIAL, ENVIRONMENTS = "tutorials/train_a_policy/train_a_policy.html", "reference/environments.html"
PAGES = (
    "",
    "start/participant.html",
    "failures.html",
    "reference/rest.html",
    "search.html?q=Wilson",
    ENVIRONMENTS,
    TUTORIAL,
)


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
        if path.startswith("search.html"):
            expect(page.locator(".search-summary")).to_contain_text("found")
        assert page.evaluate("document.documentElement.scrollWidth") <= size["width"], f"{path} scrolls sideways"
        assert violations(page) == [], path
    assert complaints.heard == []
    context.close()


class Links(HTMLParser):
    """What a page names, and what it can be named by."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.targets: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(page.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = {name: value for name, value in attrs if value}
        self.targets |= {named[name] for name in ("href", "src", "srcset") if name in named}
        self.anchors |= {named[name] for name in ("id", "name") if name in named}


def test_every_link_of_the_built_site_leads_somewhere() -> None:
    pages = {page: Links(page) for page in SITE.rglob("*.html")}
    assert len(pages) > 30
    broken = []
    for page, links in pages.items():
        for target in links.targets:
            address = urlsplit(target)
            if address.scheme or address.netloc or target.startswith("/"):
                continue
            file = (page.parent / unquote(address.path)).resolve() if address.path else page
            anchored = address.fragment in {"", *pages[file].anchors} if file in pages else not address.fragment
            if not file.is_file() or not anchored:
                broken.append(f"{page.relative_to(SITE)}: {target}")
    assert broken == []


def test_the_tutorial_shows_what_its_cells_printed(browser: Browser, site: SiteUnderTest) -> None:
    page = browser.new_page()
    page.goto(f"{site.address}/docs/{TUTORIAL}")
    expect(page.get_by_text("marker_flow (2, 2, 128, 2)")).to_be_visible()
    expect(page.get_by_text("['policy.py', 'submission.yaml', 'weights.npz']")).to_be_visible()
    page.close()


@pytest.mark.parametrize(("wish", "shown"), [("no-preference", ".webp"), ("reduce", "-still.webp")])
def test_environments_move_unless_less_motion_is_wished(
    browser: Browser, site: SiteUnderTest, wish: str, shown: str
) -> None:
    page = browser.new_page(reduced_motion=wish)  # type: ignore[arg-type]
    page.goto(f"{site.address}/docs/{ENVIRONMENTS}")
    pictures = page.locator("picture img")
    for number, task in enumerate(("fusion-insertion", "lock-opening", "peg-insertion")):
        picture = pictures.nth(number)
        picture.scroll_into_view_if_needed()
        expect(picture).to_have_js_property("complete", value=True)
        assert picture.evaluate("image => image.currentSrc").endswith(f"/{task}{shown}")
        assert picture.evaluate("image => image.naturalWidth") == 640
    page.close()


def test_search_finds_a_page(browser: Browser, site: SiteUnderTest) -> None:
    page = browser.new_page()
    page.goto(f"{site.address}/docs/")
    page.get_by_placeholder("Search").fill("Wilson interval")
    page.keyboard.press("Enter")
    expect(page.locator("#search-results li a").first).to_be_visible()
    page.close()


def test_a_page_leads_back_to_the_arena(browser: Browser, site: SiteUnderTest) -> None:
    page = browser.new_page()
    page.goto(f"{site.address}/docs/start/participant.html")
    icon = page.locator("link[rel~=icon]").evaluate("link => link.href")
    assert page.request.get(icon).headers["content-type"].startswith("image/svg+xml")
    page.get_by_role("link", name="To the arena").click()
    expect(page).to_have_url(f"{site.address}/")
    page.close()
