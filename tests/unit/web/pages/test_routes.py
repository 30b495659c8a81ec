from html.parser import HTMLParser

import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import LOCK
from seeded_site import GELBOTS, SeededSite
from vitac.server.submissions import listing
from vitac.web.headers import HEADERS


class Outline(HTMLParser):
    """Counts start tags and collects ids."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.ids += [value for name, value in attrs if name == "id" and value]


PAGES = [
    "/",
    "/tracks/track_1",
    f"/tracks/track_1?task={LOCK}",
    "/tracks/track_1/rules",
    "/sign-in",
    "/submissions",
    "/nothing-here",
    "runs",
    "done",
    "both",
    "broke",
]


@pytest.mark.parametrize("page", PAGES)
def test_every_page_has_landmarks_one_heading_unique_ids_and_the_security_headers(site: SeededSite, page: str) -> None:
    answer = site.visitor(GELBOTS).get(page if page.startswith("/") else site.path_of(page))
    outline = Outline(answer.text)
    assert answer.text.startswith('<!doctype html>\n<html lang="en">')
    for once in ("h1", "main", "header", "footer", "head"):
        assert outline.tags.count(once) == 1, once
    assert "nav" in outline.tags
    assert len(outline.ids) == len(set(outline.ids))
    assert dict(answer.headers).items() >= {name.lower(): value for name, value in HEADERS.items()}.items()
    assert "unsafe" not in answer.headers["content-security-policy"]


def test_what_a_team_sees_is_kept_by_no_cache(site: SeededSite) -> None:
    assert site.visitor().get("/").headers["cache-control"] == "no-cache"
    own = site.visitor(GELBOTS).get("/").headers
    assert (own["cache-control"], own["vary"]) == ("no-store", "Cookie")


def test_static_files_are_sent_compressed_and_kept_for_ever_under_their_digest_only(browser: AsgiBrowser) -> None:
    address = browser.get("/").text.split('rel="stylesheet" href="')[1].split('"')[0]
    sent = browser.get(address)
    assert "immutable" in sent.headers["cache-control"]
    assert sent.headers["content-encoding"] == "gzip"
    assert int(sent.headers["content-length"]) < len(sent.text) / 3
    of_before = address.partition("?v=")[0] + "?v=0123456789ab"  # named by a page from before an upgrade
    for unnamed in ("/static/arena.css", of_before):
        assert browser.get(unnamed).headers["cache-control"] == "no-cache"
    assert browser.get("/static/arena.css").headers["x-content-type-options"] == "nosniff"
    assert browser.get("/static/../pages.py").status_code == 404


def test_times_are_utc_and_machine_readable(site: SeededSite, browser: AsgiBrowser) -> None:
    with site.database.reading() as session:
        by, settings = site.seed.people[GELBOTS], site.services.settings
        submitted = listing.get(session, settings, by, site.id_of("both")).submitted_at
    assert f'datetime="{submitted:%Y-%m-%dT%H:%M:%SZ}"' in browser.get("/tracks/track_1").text


def test_head_requests_are_answered(browser: AsgiBrowser) -> None:
    assert browser.head("/").status_code == 200
