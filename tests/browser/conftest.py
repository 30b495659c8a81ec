"""A real browser (Debian's chromium, driven by playwright) and pages with fixed content served on this machine."""

import os
import shutil
from collections.abc import Iterator

import pytest
from page_fixtures import (
    FixedData,
    a_leaderboard,
    a_submission,
    a_visitor,
    an_application,
    an_entry,
)
from playwright.sync_api import Browser, Page, sync_playwright
from site_under_test import SiteUnderTest
from vitac.cli.web_server import WebServer, address_of, bind
from vitac.server.db.states import EvaluationState, Role
from vitac.server.views import VerdictView

ARGUMENTS = (
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-gpu",
    "--disable-quic",
    "--disable-sync",
    "--no-first-run",
)


def chromium() -> str:
    """The browser's program; without one the page tests fail, they never skip."""
    found = os.environ.get("VITAC_CHROMIUM") or shutil.which("chromium")
    if not found:
        pytest.fail("No chromium: install the package `chromium`, or set VITAC_CHROMIUM to the program.", pytrace=False)
    return found


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    # Not for the whole session: playwright keeps an event loop in this thread, which other tests must not find running.
    arguments = [*ARGUMENTS, *(["--no-sandbox"] if os.geteuid() == 0 else [])]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=arguments)
        yield browser
        browser.close()


@pytest.fixture
def site() -> Iterator[SiteUnderTest]:
    data = FixedData(
        visitors=[a_visitor("Gelbots"), a_visitor("Bears"), a_visitor("organizers", Role.ORGANIZER)],
        board=a_leaderboard(
            an_entry(1, "Tactile Bears", (84, 80, 77), 4.31, "bear-sac-v4"),
            an_entry(2, "Gelbots", (80, 74, 80), 4.92, "marker transformer with a long name"),
            an_entry(3, "demo", (20, 11, 9), 6.02, "peg insertion heuristic"),
            an_entry(None, "Old Team", (60, 60, 60), 5.0),
        ),
        found=[
            a_submission("Gelbots", EvaluationState.QUEUED, name="waits", workers=0),
            a_submission("Gelbots", EvaluationState.RUNNING, name="runs", done=137),
            a_submission("Gelbots", EvaluationState.COMPLETED, name="done"),
            a_submission(
                "Gelbots",
                EvaluationState.FAILED,
                name="broke",
                done=30,
                verdict=VerdictView(code="crashed", title="The policy crashed.", message="No.", task=None, episode=4),
                log_tail="Traceback (most recent call last):\n  ValueError: " + "no markers " * 40,
            ),
            a_submission("Gelbots", EvaluationState.CANCELLED, name="stopped", done=12),
        ],
    )
    listener = bind("127.0.0.1", 0)
    server = WebServer(app=an_application(data), listener=listener)
    server.start()
    yield SiteUnderTest(address=address_of(listener), data=data)
    server.stop()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    context = browser.new_context()
    yield context.new_page()
    context.close()
