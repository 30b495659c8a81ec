"""A real browser (Debian's chromium, driven by playwright) and pages with fixed content served on this machine."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from page_fixtures import (
    DIVERGENCE,
    LOCK,
    TASK,
    a_leaderboard,
    a_log,
    a_past_result,
    a_sandbox,
    a_score,
    a_submission,
    a_visitor,
    an_action_match,
    an_entry,
)
from page_service import FixedData, an_application
from playwright.sync_api import Browser, Page, expect
from real_browser import WITHOUT_GPU, launched
from service_client import serving
from site_under_test import SiteUnderTest
from vitac.evaluator.logs.findings import VerificationResult
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.database.states import EvaluationState, Role
from vitac.server.views.evaluations import VerdictView
from vitac.server.views.leaderboards import LeaderboardView
from vitac.server.views.submissions import EpisodeOutputView
from vitac.web.front import Recent
from waiting import LIMIT_S

expect.set_options(timeout=1000 * LIMIT_S)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    # Not for the whole session: playwright keeps an event loop in this thread, which other tests must not find running.
    with launched(*WITHOUT_GPU) as browser:
        yield browser


def boards() -> dict[str | None, LeaderboardView]:
    """The board of all tasks and that of each, with the same teams."""
    teams = (
        ("Tactile Bears", "bear-sac-v4", (a_score((84, 80, 77), 4.31), a_score((40, 38, 35, 40), 9.12, LOCK))),
        ("Gelbots", "marker transformer with a long name", (a_score((80, 74, 80), 4.92),)),
        ("demo", "peg insertion heuristic", (a_score((20, 11, 9), 6.02), a_score((0, 0, 0, 0), None, LOCK))),
    )
    return {
        task: a_leaderboard(
            *(
                an_entry(rank, team, *scores, name=name, task=task)
                for rank, (team, name, scores) in enumerate(teams, 1)
            ),
            an_entry(None, "Old Team", a_score((60, 60, 60), 5.0), task=task),
            task=task,
        )
        for task in (None, TASK)
    }


@pytest.fixture
def site() -> Iterator[SiteUnderTest]:
    data = FixedData(
        visitors=[a_visitor("Gelbots"), a_visitor("Bears"), a_visitor("organizers", Role.ORGANIZER)],
        board=boards()[None],
        task_boards={TASK: boards()[TASK]},
        matches=[an_action_match()],
        past=[
            a_past_result(name, rate, days)
            for name, rate, days in (("first", 0.3, 9), ("second", 0.2, 6), ("done", 0.87, 0))
        ],
        described=[a_sandbox(), a_sandbox(machine="aarch64", simd=("ASIMD",))],
        printed=[
            EpisodeOutputView(task=TASK, episode=number, outcome="success", output="markers " * 60)
            for number in (1, 4, 9)
        ],
        found=[
            a_log(EvaluationState.COMPLETED, VerificationResult.VERIFIED, reason="all states are equal"),
            a_log(EvaluationState.FAILED, VerificationResult.DIVERGED, divergence=DIVERGENCE),
            a_log(EvaluationState.COMPLETED, None, kind=SubmissionKind.TEXT_LOG, problems=["test 3: no step"] * 30),
            a_submission("Gelbots", EvaluationState.QUEUED, name="waits", workers=0),
            a_submission("Gelbots", EvaluationState.RUNNING, name="runs", done=137),
            a_submission("Gelbots", EvaluationState.COMPLETED, name="done"),
            a_submission("Gelbots", EvaluationState.COMPLETED, name="both", tasks=(TASK, LOCK)),
            a_submission("Gelbots", EvaluationState.RUNNING, name="halfway", tasks=(TASK, LOCK), done=301),
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
    application = an_application(data)
    application.state.site = replace(application.state.site, front=Recent(kept_s=0.0))
    with serving(application) as (host, port):
        yield SiteUnderTest(address=f"http://{host}:{port}", data=data)


@pytest.fixture
def page(browser: Browser, site: SiteUnderTest) -> Iterator[Page]:
    """A page, closed before the site ends, which would wait two seconds for its stream of events."""
    context = browser.new_context()
    yield context.new_page()
    context.close()
