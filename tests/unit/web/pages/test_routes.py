from datetime import UTC, datetime, timedelta
from html.parser import HTMLParser

import psycopg
import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import (
    DIVERGENCE,
    LOCK,
    NOW,
    SIGNER,
    TASK,
    FixedData,
    a_leaderboard,
    a_log,
    a_score,
    a_submission,
    a_visitor,
    an_action_match,
    an_application,
    an_entry,
    an_id,
)
from sqlalchemy.exc import OperationalError
from vitac.evaluator.logs.findings import VerificationResult
from vitac.server.db.states import EvaluationState, Role, SubmissionKind
from vitac.server.views.evaluations import DifferingEpisodeView, VerdictView
from vitac.server.views.leaderboards import LeaderboardView
from vitac.server.views.submissions import SubmissionView
from vitac.web.headers import HEADERS
from vitac.web.session import signer

GELBOTS, BEARS, ORGANIZERS = a_visitor("Gelbots"), a_visitor("Bears"), a_visitor("organizers", Role.ORGANIZER)
RUNNING = a_submission("Gelbots", EvaluationState.RUNNING, name="runs", done=137)
COMPLETED = a_submission("Gelbots", EvaluationState.COMPLETED, name="done")
BOTH = a_submission("Gelbots", EvaluationState.COMPLETED, name="both", tasks=(TASK, LOCK))
FAILED = a_submission(
    "Gelbots",
    EvaluationState.FAILED,
    name="broke",
    done=30,
    verdict=VerdictView(code="crashed", title="The policy crashed.", message="ValueError", task=LOCK, episode=4),
    log_tail="<script>alert(1)</script>",
)
QUEUED = a_submission("Bears", EvaluationState.QUEUED, name="waits", workers=0)


@pytest.fixture
def data() -> FixedData:
    return FixedData(visitors=[GELBOTS, BEARS, ORGANIZERS], found=[RUNNING, COMPLETED, BOTH, FAILED, QUEUED])


@pytest.fixture
def browser(data: FixedData) -> AsgiBrowser:
    return AsgiBrowser(an_application(data))


def sign_in(browser: AsgiBrowser, name: str, **fields: str) -> None:
    answer = browser.post("/sign-in", data={"token": f"token-of-{name}"} | fields)
    assert answer.status_code == 303


def form_token(browser: AsgiBrowser) -> str:
    return SIGNER.form_token(browser.cookies[signer.COOKIE])


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


# ---- leaderboard and rules ----


BEARS_PEG, BEARS_LOCK = a_score((84, 80, 77), 4.31), a_score((40, 38, 2, 0), 11.5, LOCK)
GELBOTS_PEG = a_score((20, 11, 9), 6.02)


def test_home_ranks_all_tasks_together_and_shows_each(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = a_leaderboard(an_entry(1, "Bears", BEARS_PEG, BEARS_LOCK), an_entry(2, "Gelbots", GELBOTS_PEG))
    html = browser.get("/").text.replace("\N{NO-BREAK SPACE}", " ")
    for shown in (
        "69.6 %",
        "65.2 % to 73.8 %",
        "7.90",
        "89.3 %",
        "241 of 270",
        "4.31 env steps",
        "80 of 160",
        "11.50 env steps",
    ):
        assert shown in html
    assert html.index("Bears") < html.index("7.4 %") < html.index("not submitted")
    assert "mean of the success rates of all tasks" in html


def test_a_task_has_a_leaderboard_of_its_own_with_rates_by_shape(data: FixedData, browser: AsgiBrowser) -> None:
    data.task_boards[TASK] = a_leaderboard(an_entry(1, "Bears", BEARS_PEG, BEARS_LOCK, task=TASK), task=TASK)
    assert f'href="/tracks/track_1?task={TASK}"' in browser.get("/").text
    html = browser.get(f"/tracks/track_1?task={TASK}").text.replace("\N{NO-BREAK SPACE}", " ")
    for shown in ("Trapezoid", "85.0 % to 92.4 %, 241 of 270", "4.31", "93.3 %", "<dd>270</dd>"):
        assert shown in html
    assert "Key1" not in html
    assert f'href="/tracks/track_1?task={TASK}" aria-current="page"' in html
    assert browser.get("/tracks/track_1?task=nothing").status_code == 404


def test_home_says_so_while_nothing_is_evaluated(browser: AsgiBrowser) -> None:
    assert "No complete evaluation yet" in browser.get("/").text


def test_entry_of_another_evaluator_version_has_no_rank(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = a_leaderboard(an_entry(None, "Old Team", a_score((84, 80, 77), 4.31)))
    html = browser.get("/").text
    assert "evaluator 1+ba9876543210, not ranked" in html
    assert "<dt>Teams ranked</dt><dd>0</dd>" in html


def test_an_entry_without_success_has_no_mean_steps(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = a_leaderboard(an_entry(1, "Bears", a_score((0, 0, 0), None)))
    assert "–" in browser.get("/").text


def test_team_names_are_escaped(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = a_leaderboard(an_entry(1, "<b>Bears</b>", a_score((1, 0, 0), 4.0)))
    html = browser.get("/").text
    assert "&lt;b&gt;Bears" in html
    assert "<b>Bears" not in html


def test_submission_is_linked_for_its_own_team_only(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = a_leaderboard(an_entry(1, "Bears", a_score((84, 80, 77), 4.31)))
    link = f'href="/submissions/{an_id("Bears/policy")}"'
    assert link not in browser.get("/").text
    sign_in(browser, "Gelbots")
    assert link not in browser.get("/").text
    sign_in(browser, "Bears")
    assert link in browser.get("/").text
    sign_in(browser, "organizers")
    assert link in browser.get("/").text


def test_rules_show_the_track_file_and_the_limits(browser: AsgiBrowser) -> None:
    html = browser.get("/tracks/track_1/rules").text
    for shown in (
        "marker_flow",
        "(2, 2, 128, 2) float32",
        "relative_motion",
        "theta",
        "4 degree",
        "1.5 mm",
        "Processes",
    ):
        assert shown in html


def test_unknown_track_is_a_page_that_names_the_known_ones(browser: AsgiBrowser) -> None:
    answer = browser.get("/tracks/track_9")
    assert answer.status_code == 404
    assert "track_1" in answer.text
    assert browser.get("/tracks/track_9/rules").status_code == 404


# ---- signing in ----


def test_sign_in_sets_a_cookie_that_scripts_and_other_sites_do_not_get(browser: AsgiBrowser) -> None:
    answer = browser.post("/sign-in", data={"token": " token-of-Gelbots\n"})
    cookie = answer.headers["set-cookie"]
    assert answer.headers["location"] == "/submissions"
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    assert "token-of-Gelbots" not in cookie
    assert "Secure" not in cookie


def test_cookie_is_secure_over_https(data: FixedData) -> None:
    browser = AsgiBrowser(an_application(data), base_url="https://arena.test")
    assert "Secure" in browser.post("/sign-in", data={"token": "token-of-Gelbots"}).headers["set-cookie"]


def test_wrong_token_is_told_beside_the_field(browser: AsgiBrowser) -> None:
    answer = browser.post("/sign-in", data={"token": "vitac_wrong"})
    assert answer.status_code == 401
    assert 'aria-invalid="true"' in answer.text
    assert "unknown, revoked or expired" in answer.text
    assert "vitac_wrong" not in answer.text
    assert signer.COOKIE not in browser.cookies


@pytest.mark.parametrize(
    "target", ["https://evil.test/", "//evil.test", "/\\evil.test", "javascript:alert(1)", "", "x"]
)
def test_sign_in_leads_to_no_other_site(browser: AsgiBrowser, target: str) -> None:
    answer = browser.post("/sign-in", data={"token": "token-of-Gelbots", "next": target})
    assert answer.headers["location"] == "/submissions"


def test_sign_in_leads_back_to_where_one_came_from(browser: AsgiBrowser) -> None:
    wanted = f"/submissions/{RUNNING.id}"
    to_sign_in = browser.get(wanted)
    assert to_sign_in.status_code == 303
    assert to_sign_in.headers["location"] == f"/sign-in?next={wanted}"
    assert f'value="{wanted}"' in browser.get(to_sign_in.headers["location"]).text
    assert browser.post("/sign-in", data={"token": "token-of-Gelbots", "next": wanted}).headers["location"] == wanted


def test_revoked_token_ends_its_session(data: FixedData, browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    assert browser.get("/submissions").status_code == 200
    data.visitors.remove(GELBOTS)
    assert browser.get("/submissions").status_code == 303


def test_expired_session_is_none(browser: AsgiBrowser) -> None:
    long_ago = datetime.now(UTC) - signer.LIFETIME - timedelta(seconds=5)
    browser.cookies.set(signer.COOKIE, SIGNER.sign(signer.begin(GELBOTS.token_id, now=long_ago)))
    assert browser.get("/submissions").status_code == 303


def test_sign_out_ends_the_session(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    answer = browser.post("/sign-out", data={"form_token": form_token(browser)})
    assert answer.status_code == 303
    assert signer.COOKIE not in browser.cookies


@pytest.mark.parametrize(
    "headers",
    [
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"sec-fetch-site": "", "origin": "https://evil.test"},
    ],
)
def test_forms_of_other_sites_are_refused(browser: AsgiBrowser, headers: dict[str, str]) -> None:
    sign_in(browser, "Gelbots")
    for path in ("/sign-in", "/sign-out", f"/submissions/{RUNNING.id}/cancel"):
        answer = browser.post(path, data={"form_token": form_token(browser)}, headers=headers)
        assert answer.status_code == 403
        assert "another site" in answer.text


def test_forms_of_old_browsers_are_accepted_from_this_origin(data: FixedData) -> None:
    browser = AsgiBrowser(an_application(data), headers={"origin": "http://testserver"})
    assert browser.post("/sign-in", data={"token": "token-of-Gelbots"}).status_code == 303


def test_a_form_that_is_too_long_or_none_is_refused(browser: AsgiBrowser) -> None:
    assert browser.post("/sign-in", data={"token": "x" * 10_000}).status_code == 413
    assert browser.post("/sign-in", json={"token": "x"}).status_code == 415
    assert browser.post("/sign-in").status_code == 415


# ---- submissions ----


def test_a_team_lists_its_own_submissions_only(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    html = browser.get("/submissions").text
    assert "runs" in html
    assert "waits" not in html


def test_an_organizer_lists_all_with_their_teams(browser: AsgiBrowser) -> None:
    sign_in(browser, "organizers")
    html = browser.get("/submissions").text
    assert "runs" in html
    assert "waits" in html
    assert "Bears" in html


def test_no_submission_yet_tells_how_to_make_one(data: FixedData, browser: AsgiBrowser) -> None:
    data.found.clear()
    sign_in(browser, "Gelbots")
    assert "vitac submit FOLDER" in browser.get("/submissions").text


def test_older_submissions_are_linked(data: FixedData, browser: AsgiBrowser) -> None:
    data.next_before = RUNNING.id
    sign_in(browser, "Gelbots")
    assert f"/submissions?before={RUNNING.id}" in browser.get("/submissions").text


def test_foreign_and_missing_submissions_look_alike(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    paths = [f"/submissions/{QUEUED.id}", f"/submissions/{an_id('nobody')}", "/submissions/not-an-id"]
    for path in paths + [f"{path}/events" for path in paths]:
        answer = browser.get(path)
        assert answer.status_code == 404
        assert "Page not found" in answer.text
    for path in paths:
        assert browser.post(f"{path}/cancel", data={"form_token": form_token(browser)}).status_code == 404


def test_running_submission_updates_itself_with_and_without_script(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{RUNNING.id}").text
    assert "137 of 270" in html
    assert "about 41 s left" in html
    assert f'data-events="/submissions/{RUNNING.id}/events"' in html
    assert '<noscript><meta http-equiv="refresh" content="5"></noscript>' in html
    assert "http-equiv" not in browser.get(f"/submissions/{RUNNING.id}?refresh=off").text


def test_completed_submission_shows_its_score_and_stands_still(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{COMPLETED.id}").text.replace("\N{NO-BREAK SPACE}", " ")
    for shown in ("86.7 %", "82.1 % to 90.2 %", "4.92", "Rank 2 of 4", COMPLETED.evaluation.result_hash or "", "54 s"):
        assert shown in html
    for gone in ("data-events", "http-equiv", "Cancel this evaluation", "live.js"):
        assert gone not in html


def test_a_submission_of_one_task_says_which_it_lacks(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{COMPLETED.id}").text
    assert "Lock opening: not part of this submission" in html
    assert "not part of this submission" not in browser.get(f"/submissions/{BOTH.id}").text


def test_a_submission_of_two_tasks_shows_each_with_rank_and_hash(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{BOTH.id}").text.replace("\N{NO-BREAK SPACE}", " ")
    for shown in (
        "73.3 %",
        "8.71",
        "86.7 %",
        "60.0 %",
        "96 of 160",
        "12.50",
        f'?task={LOCK}">1 of 3',
        "5c7e" * 16,
        "9f3b" * 16,
    ):
        assert shown in html
    assert html.index('id="task-peg-insertion"') < html.index("Trapezoid") < html.index('id="task-lock-opening"')
    assert 'aria-label="Key4: ' in html


def test_a_running_submission_of_two_tasks_shows_the_progress_of_each(data: FixedData, browser: AsgiBrowser) -> None:
    data.found.append(a_submission("Gelbots", EvaluationState.RUNNING, name="two", tasks=(TASK, LOCK), done=300))
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{data.found[-1].id}").text
    for shown in ("300 of 430", "270 of 270", "30 of 160"):
        assert shown in html


def test_failed_submission_shows_verdict_and_escaped_output(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{FAILED.id}").text
    for shown in ("The policy crashed.", "crashed", "lock opening, episode 4", "&lt;script&gt;alert(1)&lt;/script&gt;"):
        assert shown in html
    assert "<script>alert" not in html


@pytest.mark.parametrize(("memory", "is_told"), [("watchdog", True), ("cgroup-v2", False)])
def test_a_result_without_a_control_group_is_shown_as_isolated_more_weakly(
    browser: AsgiBrowser, data: FixedData, memory: str, is_told: bool
) -> None:
    levels = [f"user: root, memory: {memory}, episodes: frozen-copy, process ids repeat: True"]
    evaluation = COMPLETED.evaluation.model_copy(update={"isolation": levels})
    data.found = [COMPLETED.model_copy(update={"evaluation": evaluation})]
    sign_in(browser, "Gelbots")
    assert ("Weaker than usual" in browser.get(f"/submissions/{COMPLETED.id}").text) is is_told


def test_organizers_page_says_that_an_episode_was_played_again_with_another_result(
    data: FixedData, browser: AsgiBrowser
) -> None:
    alarm = DifferingEpisodeView(
        task="peg-insertion",
        episode=7,
        stored_digest="01" * 32,
        differing_digest="02" * 32,
        worker_id=None,
        seen_at=RUNNING.submitted_at,
    )
    evaluation = RUNNING.evaluation.model_copy(update={"differing_episodes": [alarm]})
    data.found = [RUNNING.model_copy(update={"evaluation": evaluation})]
    sign_in(browser, "organizers")
    html = browser.get(f"/submissions/{RUNNING.id}").text
    assert "1 episode was played again with another result." in html
    assert f"vitac admin evaluation show {evaluation.id}" in html


def test_queued_submission_shows_its_position_and_that_no_worker_runs(browser: AsgiBrowser) -> None:
    sign_in(browser, "Bears")
    html = browser.get(f"/submissions/{QUEUED.id}").text
    assert "Number 2 in the queue" in html
    assert "No worker is running since" in html


def test_reused_episodes_are_counted(data: FixedData, browser: AsgiBrowser) -> None:
    stored = a_submission("Gelbots", EvaluationState.RUNNING, name="stored", done=137, reused=120)
    data.found.append(stored)
    sign_in(browser, "Gelbots")
    assert "120 episodes are reused" in browser.get(f"/submissions/{stored.id}").text


def test_cancel_needs_the_sessions_form_token(data: FixedData, browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    path = f"/submissions/{RUNNING.id}/cancel"
    assert browser.post(path, data={"other": "x"}).status_code == 403
    assert browser.post(path, data={"form_token": "00"}).status_code == 403
    assert data.cancelled == []
    assert browser.post(path, data={"form_token": form_token(browser)}).status_code == 303
    assert data.cancelled == [RUNNING.id]


def test_cancelling_what_has_ended_is_a_page_that_says_so(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    answer = browser.post(f"/submissions/{COMPLETED.id}/cancel", data={"form_token": form_token(browser)})
    assert answer.status_code == 409
    assert "The evaluation has ended." in answer.text


def test_events_of_a_finished_evaluation_are_one_view_and_the_end(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    answer = browser.get(f"/submissions/{COMPLETED.id}/events")
    assert answer.headers["content-type"].startswith("text/event-stream")
    events = [line.removeprefix("event: ") for line in answer.text.splitlines() if line.startswith("event: ")]
    assert events == ["view", "end"]
    assert "86.7" in answer.text


def test_events_need_a_session_and_do_not_come_back_without(browser: AsgiBrowser) -> None:
    assert browser.get(f"/submissions/{COMPLETED.id}/events").status_code == 204


# ---- every page ----

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
    assert browser.get("/static/../pages.py").status_code == 404


def test_times_are_utc_and_machine_readable(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = a_leaderboard(an_entry(1, "Bears", a_score((84, 80, 77), 4.31)))
    submitted = (NOW - timedelta(hours=3)).strftime("%Y-%m-%dT%H:%M:%SZ")
    assert f'datetime="{submitted}"' in browser.get("/").text


def test_head_requests_are_answered(browser: AsgiBrowser) -> None:
    assert browser.head("/").status_code == 200


# ---- error pages ----


def test_browsers_get_a_page_and_programs_their_json(browser: AsgiBrowser) -> None:
    page = browser.get("/nothing-here")
    assert page.status_code == 404
    assert "<h1>Page not found</h1>" in page.text
    assert browser.get("/nothing-here", headers={"accept": "application/json"}).json() == {"detail": "Not Found"}
    assert browser.get("/api/v1/nothing-here").headers["content-type"] == "application/json"


def test_a_crash_is_a_page_that_tells_nothing_of_the_inside(data: FixedData, browser: AsgiBrowser) -> None:
    data.board = None  # type: ignore[assignment]
    answer = browser.get("/")
    assert answer.status_code == 500
    assert "Internal error" in answer.text
    assert "Traceback" not in answer.text
    assert answer.headers["content-security-policy"] == HEADERS["Content-Security-Policy"]


def test_database_that_is_away_is_a_page_that_says_when_to_come_back(data: FixedData, browser: AsgiBrowser) -> None:
    async def away(track: str, task: str | None) -> LeaderboardView:
        raise OperationalError("SELECT 1", {}, psycopg.OperationalError("connection refused"))

    data.leaderboard = away  # type: ignore[method-assign]
    answer = browser.get("/")
    assert answer.status_code == 503
    assert answer.headers["retry-after"] == "2"
    assert "Nothing is lost" in answer.text


def test_wrong_method_is_a_page(browser: AsgiBrowser) -> None:
    answer = browser.post("/tracks/track_1")
    assert answer.status_code == 405
    assert "GET" in answer.headers["allow"]


# ---- logs ----

VERIFIED = a_log(EvaluationState.COMPLETED, VerificationResult.VERIFIED, reason="all states are equal")
DIVERGED = a_log(EvaluationState.FAILED, VerificationResult.DIVERGED, divergence=DIVERGENCE)
TEXT_LOG = a_log(
    EvaluationState.COMPLETED,
    None,
    kind=SubmissionKind.TEXT_LOG,
    problems=["test 3: <b>step 2</b> lacks an offset"] * 30,
)


def page_of(data: FixedData, browser: AsgiBrowser, submission: SubmissionView) -> str:
    data.found = [submission]
    sign_in(browser, "Gelbots")
    return browser.get(f"/submissions/{submission.id}").text.replace("\N{NO-BREAK SPACE}", " ")


def test_logs_of_a_track_rank_apart_and_text_logs_stand_beside_their_claims(browser: AsgiBrowser) -> None:
    html = browser.get("/tracks/track_1/logs").text.replace("\N{NO-BREAK SPACE}", " ")
    for shown in ("actions verified, policy not seen", "90.0 %", "verified within tolerance", "243 of 270"):
        assert shown in html
    assert "No verified log of this task yet" in html
    for shown in ("does not reproduce itself", "90.6 %", "85.0 %", "lock opening", "not ranked"):
        assert shown in html
    assert 'href="/tracks/track_1/logs" aria-current="page"' in html


def test_leaderboard_leads_to_the_logs(browser: AsgiBrowser) -> None:
    assert '<a href="/tracks/track_1/logs">Logs</a>' in browser.get("/").text


def test_rules_say_what_a_log_is_worth(browser: AsgiBrowser) -> None:
    html = browser.get("/tracks/track_1/rules").text
    assert "not that a policy chose them" in html
    assert "at most 32 MiB" in html


def test_verified_log_says_what_that_proves(data: FixedData, browser: AsgiBrowser) -> None:
    html = page_of(data, browser, VERIFIED)
    for shown in ("Verified:", "all states are equal", "not that a policy chose them", "has no evaluated model yet"):
        assert shown in html
    assert "Isolation" not in html


def test_models_that_give_the_actions_of_a_log_are_named(data: FixedData, browser: AsgiBrowser) -> None:
    data.matches = [an_action_match()]
    html = page_of(data, browser, VERIFIED)
    for shown in ("my model", "808 of 810", "269 of 270", "episode 5, env step 2"):
        assert shown in html


def test_diverged_log_shows_both_states(data: FixedData, browser: AsgiBrowser) -> None:
    html = page_of(data, browser, DIVERGED)
    for shown in ("Episode 31, env step 2", "ab" * 6, "cd" * 6, "surface_diff_m", "0.0004322, 0.0005"):
        assert shown in html


def test_text_log_says_why_it_cannot_be_verified(data: FixedData, browser: AsgiBrowser) -> None:
    html = page_of(data, browser, TEXT_LOG)
    for shown in ("cannot be verified", "6 to 12 of 100", "90.0 %", "and 10 more"):
        assert shown in html
    assert "<b>step 2</b>" not in html
