from datetime import timedelta
from html.parser import HTMLParser

import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import LOCK, NOW, a_leaderboard, a_score, an_entry
from page_service import FixedData, an_application
from visits import BEARS, BOTH, COMPLETED, FAILED, QUEUED, RUNNING, sign_in
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
] + [f"/submissions/{submission.id}" for submission in (RUNNING, COMPLETED, BOTH, FAILED)]


@pytest.mark.parametrize("path", PAGES)
def test_every_page_has_landmarks_one_heading_and_unique_ids(browser: AsgiBrowser, path: str) -> None:
    sign_in(browser, "Gelbots")
    html = browser.get(path).text
    outline = Outline(html)
    assert html.startswith('<!doctype html>\n<html lang="en">')
    for once in ("h1", "main", "header", "footer", "head"):
        assert outline.tags.count(once) == 1, once
    assert "nav" in outline.tags
    assert len(outline.ids) == len(set(outline.ids))


@pytest.mark.parametrize("path", [*PAGES, "/static/arena.css"])
def test_every_answer_has_the_security_headers(browser: AsgiBrowser, path: str) -> None:
    sign_in(browser, "Gelbots")
    headers = browser.get(path).headers
    for name, value in HEADERS.items():
        assert headers[name] == value
    assert "unsafe" not in headers["content-security-policy"]


def test_what_a_team_sees_is_kept_by_no_cache(browser: AsgiBrowser) -> None:
    assert browser.get("/").headers["cache-control"] == "no-cache"
    sign_in(browser, "Gelbots")
    assert browser.get("/").headers["cache-control"] == "no-store"
    assert browser.get("/").headers["vary"] == "Cookie"


def test_static_files_are_kept_for_ever_under_their_digest_only(browser: AsgiBrowser) -> None:
    html = browser.get("/").text
    address = html.split('rel="stylesheet" href="')[1].split('"')[0]
    assert "immutable" in browser.get(address).headers["cache-control"]
    assert browser.get("/static/arena.css").headers["cache-control"] == "no-cache"
    of_before = address.partition("?v=")[0] + "?v=0123456789ab"  # named by a page from before an upgrade
    assert browser.get(of_before).headers["cache-control"] == "no-cache"
    assert browser.get("/static/../pages.py").status_code == 404


def test_times_are_utc_and_machine_readable(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = a_leaderboard(an_entry(1, "Bears", a_score((84, 80, 77), 4.31)))
    submitted = (NOW - timedelta(hours=3)).strftime("%Y-%m-%dT%H:%M:%SZ")
    assert f'datetime="{submitted}"' in browser.get("/tracks/track_1").text


def test_head_requests_are_answered(browser: AsgiBrowser) -> None:
    assert browser.head("/").status_code == 200


def test_applications_of_one_process_share_their_pages_and_no_content(browser: AsgiBrowser) -> None:
    other = AsgiBrowser(an_application(FixedData(visitors=[BEARS], found=[QUEUED])))
    sign_in(other, "Bears")
    sign_in(browser, "Gelbots")
    assert browser.get(f"/submissions/{RUNNING.id}").status_code == 200
    assert other.get(f"/submissions/{RUNNING.id}").status_code == 404
    assert other.get(f"/submissions/{QUEUED.id}").status_code == 200


def test_scripts_and_styles_are_sent_compressed(browser: AsgiBrowser) -> None:
    address = browser.get("/").text.split('rel="stylesheet" href="')[1].split('"')[0]
    sent = browser.get(address)
    assert sent.headers["content-encoding"] == "gzip"
    assert ":root" in sent.text
    assert int(sent.headers["content-length"]) < len(sent.text) / 3
