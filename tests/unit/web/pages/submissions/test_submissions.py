import re
from typing import Any

import pytest
from asgi_browser import AsgiBrowser
from page_fixtures import DIVERGENCE, LOCK, TASK, a_log, an_action_match, an_id
from page_service import FixedData
from visits import BOTH, COMPLETED, FAILED, QUEUED, RUNNING, form_token, page_of, sign_in
from vitac.envs.tasks.definition import Family
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.logs.findings import VerificationResult
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.database.states import EvaluationState
from vitac.server.errors import TRACK_REMOVED
from vitac.server.views.comparisons import StillView
from vitac.server.views.evaluations import DifferingEpisodeView, EvaluationView, PackagesView
from vitac.web.pages.submissions import submissions
from vitac.web.plots.map import EpisodeMap, episode_map

VERIFIED = a_log(EvaluationState.COMPLETED, VerificationResult.VERIFIED, reason="all states are equal")
DIVERGED = a_log(EvaluationState.FAILED, VerificationResult.DIVERGED, divergence=DIVERGENCE)
TEXT_LOG = a_log(
    EvaluationState.COMPLETED,
    None,
    kind=SubmissionKind.TEXT_LOG,
    problems=["test 3: <b>step 2</b> lacks an offset"] * 30,
)


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


def test_a_row_changes_with_what_it_shows(data: FixedData, browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    assert browser.get("/submissions").text == browser.get("/submissions").text
    evaluation = RUNNING.evaluation
    further = evaluation.progress.model_copy(update={"episodes_done": evaluation.progress.episodes_done + 1})
    for changed, shown in (
        ({"progress": further}, f"{further.episodes_done} of {further.episodes_total}"),
        ({"state": EvaluationState.CANCELLED}, "Cancelled"),
    ):
        assert shown not in browser.get("/submissions").text
        place = next(place for place, found in enumerate(data.found) if found.id == RUNNING.id)
        data.found[place] = RUNNING.model_copy(update={"evaluation": evaluation.model_copy(update=changed)})
        assert shown in browser.get("/submissions").text


def test_page_of_a_remote_policy_says_what_its_result_proves(data: FixedData, browser: AsgiBrowser) -> None:
    place = next(place for place, found in enumerate(data.found) if found.id == COMPLETED.id)
    data.found[place] = COMPLETED.model_copy(update={"kind": SubmissionKind.REMOTE})
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{COMPLETED.id}").text
    assert "This proves the actions, not which program or person chose them." in html
    assert "<code>vitac evaluate --remote</code>" in html


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


def test_the_map_of_a_completed_evaluation_is_drawn_once_and_that_of_a_running_one_each_time(
    data: FixedData, browser: AsgiBrowser, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[str] = []

    def draw(track: str, task: str, *ends: Any, **more: Any) -> EpisodeMap:
        drawn.append(task)
        return episode_map(track, task, *ends, **more)

    monkeypatch.setattr(submissions, "episode_map", draw)
    sign_in(browser, "Gelbots")
    shown = [browser.get(f"/submissions/{COMPLETED.id}").text for _ in range(3)]
    assert len(drawn) == 1
    assert shown[0] == shown[1] == shown[2]
    assert shown[0].count(f'<a href="/submissions/{COMPLETED.id}/episodes/{TASK}/') == 270 + 4
    data.found.append(hidden := COMPLETED.model_copy(update={"evaluation": without_episodes()}))
    data.found.remove(COMPLETED)
    assert "episodes/peg-insertion/" not in browser.get(f"/submissions/{hidden.id}").text
    for _ in range(2):
        browser.get(f"/submissions/{RUNNING.id}")
    assert len(drawn) == 4


def without_episodes() -> EvaluationView:
    """The completed evaluation for somebody to whom single episodes are not shown."""
    progress = COMPLETED.evaluation.progress.model_copy(update={"tasks": []})
    return COMPLETED.evaluation.model_copy(update={"progress": progress})


def test_completed_submission_shows_its_score_and_stands_still(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{COMPLETED.id}").text.replace("\N{NO-BREAK SPACE}", " ")
    for shown in ("86.7 %", "82.1 % to 90.2 %", "4.92", "Rank 1 of 3", COMPLETED.evaluation.result_hash or "", "54 s"):
        assert shown in html
    for gone in ("data-events", "http-equiv", "Cancel this evaluation", "live.js"):
        assert gone not in html


def test_an_appeal_is_offered_where_some_are_taken(data: FixedData, browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    for data.takes_appeals in (False, True):
        html = browser.get(f"/submissions/{COMPLETED.id}").text
        assert ("/appeals?submission=" in html) == data.takes_appeals


def test_completed_submission_explains_its_outcomes(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{COMPLETED.id}").text
    shown = re.findall(r'<li>\d+ (\w+): ([^<]+) <a href="([^"]+)">Play episode (\d+)</a></li>', html)
    assert {"success", "tactile"} <= {outcome for outcome, *_ in shown}
    for outcome, sentence, address, episode in shown:
        assert sentence == EpisodeOutcome(outcome).sentence
        assert address == f"/submissions/{COMPLETED.id}/episodes/{TASK}/{episode}"
        assert f'<a href="{address}"><title>Episode {episode},' in html


def test_a_submission_of_one_task_says_which_it_lacks(browser: AsgiBrowser) -> None:
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{COMPLETED.id}").text
    text = html.replace("\N{NO-BREAK SPACE}", " ")
    assert "Lock opening: not part of this submission" in text
    assert "a missing task counts as 0, which makes 43.3 % and rank 2 of 4." in text
    assert "not part of this submission" not in browser.get(f"/submissions/{BOTH.id}").text


@pytest.mark.parametrize(
    ("tasks", "says", "says_not"),
    [
        (
            ("sensor-standard", "sensor-blind"),
            "Own policy: not part of this submission. Without it there is no",
            "of 270",
        ),
        (("sensor-design", "sensor-standard", "sensor-blind"), "86.7 % 234 of 270 in Own policy", "not part of this"),
    ],
)
def test_a_sensor_has_a_rate_of_all_tasks_only_with_a_policy_of_its_own(
    tasks: tuple[str, ...], says: str, says_not: str, data: FixedData, browser: AsgiBrowser
) -> None:
    """Of Track 3 the own policy alone counts."""
    own = COMPLETED.evaluation
    nothing = own.progress.model_copy(update={"tasks": []})
    changes = {"scores": [], "progress": nothing, "counted_tasks": ["sensor-design"], "played": None}
    if "sensor-design" in tasks and own.played:
        changes["played"] = own.played.model_copy(update={"tasks": ["sensor-design"]})
    sensor = COMPLETED.model_copy(
        update={
            "id": an_id("a sensor"),
            "track": "track_3",
            "tasks": list(tasks),
            "missing_tasks": [name for name in ("sensor-design",) if name not in tasks],
            "evaluation": own.model_copy(update=changes),
            "task_ranks": {},
        }
    )
    data.found.append(sensor)
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{sensor.id}").text.replace("\N{NO-BREAK SPACE}", " ")
    text = " ".join(re.sub(r"<[^>]+>", " ", html).split())
    assert says in text
    assert says_not not in text


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


def test_a_submission_of_a_removed_track_shows_the_score_that_is_kept(data: FixedData, browser: AsgiBrowser) -> None:
    data.found = [kept.model_copy(update={"track": "chess", "public": True}) for kept in (BOTH, FAILED)]
    for name, is_own in (("Bears", False), ("Gelbots", True)):
        sign_in(browser, name)
        answer = browser.get(f"/submissions/{BOTH.id}")
        assert answer.status_code == 410
        assert f"{TRACK_REMOVED} It played peg insertion, lock opening of <code>chess</code>." in answer.text
        for score in BOTH.evaluation.scores:
            assert f"{score.successes} of {score.episodes}" in answer.text
        assert ("Signed receipt" in answer.text) == is_own
        assert "/tracks/chess" not in answer.text, "it leads nowhere"
    answer = browser.get(f"/submissions/{FAILED.id}")
    assert (answer.status_code, "It has no score." in answer.text) == (410, True)


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
    page = browser.get(f"/submissions/{COMPLETED.id}").text
    assert ("Weaker than usual" in page) is is_told
    assert "Where process ids repeat, that of an episode does not show how many there were before." in page
    data.found = [COMPLETED.model_copy(update={"evaluation": evaluation.model_copy(update={"isolation": []})})]
    assert "Where process ids repeat" not in browser.get(f"/submissions/{COMPLETED.id}").text


def test_packages_of_each_kind_of_worker_are_told_short_and_in_full(browser: AsgiBrowser, data: FixedData) -> None:
    kinds = [{"msgspec": "1", "numpy": "2.5", "torch": "2.13+cpu"}, {"msgspec": "1", "numpy": "2.5"}, {"<b>": "1"}]
    packages = [PackagesView(digest=str(number) * 64, versions=kind) for number, kind in enumerate(kinds)]
    evaluation = COMPLETED.evaluation.model_copy(update={"packages": packages})
    data.found = [COMPLETED.model_copy(update={"evaluation": evaluation})]
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{COMPLETED.id}").text
    shown = html.split("<dt>Packages</dt>")[1:]
    summaries = [part.partition("<summary>")[2].partition("</summary>")[0] for part in shown]
    assert summaries == ["numpy 2.5, torch 2.13+cpu, 3 in all", "numpy 2.5, 2 in all", "1 in all"]
    assert "msgspec 1, numpy 2.5, torch 2.13+cpu<br>" in shown[0]
    assert [str(number) * 64 in part for number, part in enumerate(shown)] == [True, True, True]
    assert "&lt;b&gt; 1" in shown[2]


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


def test_a_submission_that_no_running_worker_can_play_says_what_is_missing(
    data: FixedData, browser: AsgiBrowser
) -> None:
    workers = QUEUED.workers.model_copy(update={"missing_family": Family.MANISKILL})
    data.found = [QUEUED.model_copy(update={"workers": workers})]
    sign_in(browser, "Bears")
    html = browser.get(f"/submissions/{QUEUED.id}").text
    assert "No running worker can play these tasks: none has what maniskill needs." in html
    assert "No worker is running" not in html


def test_a_submission_whose_evaluator_no_running_worker_has_says_what_will_happen(
    data: FixedData, browser: AsgiBrowser
) -> None:
    workers = QUEUED.workers.model_copy(update={"missing_evaluator": "1+yesterday"})
    data.found = [QUEUED.model_copy(update={"workers": workers})]
    sign_in(browser, "Bears")
    html = browser.get(f"/submissions/{QUEUED.id}").text
    assert "No running worker has evaluator 1+yesterday, with which this evaluation began." in html
    assert "No worker is running" not in html


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
    for shown in ("cannot be verified", "1.20", "90.0 %", "and 10 more"):
        assert shown in html
    assert "<b>step 2</b>" not in html


def test_a_result_begins_with_stills_that_lead_to_a_success_and_a_failure(
    data: FixedData, browser: AsgiBrowser
) -> None:
    ends = {4: EpisodeOutcome.TACTILE, 9: EpisodeOutcome.SUCCESS, 11: EpisodeOutcome.STEPS, 12: EpisodeOutcome.SUCCESS}
    data.stills[:] = [
        StillView(task=TASK, episode=number, outcome=end, key="5eed" * 16) for number, end in ends.items()
    ]
    sign_in(browser, "Gelbots")
    html = browser.get(f"/submissions/{COMPLETED.id}").text
    shown = re.findall(r'<li><a href="([^"]+)"><img src="\1/playback/still\?v=(?:5eed){16}"', html)
    assert shown == [f"/submissions/{COMPLETED.id}/episodes/{TASK}/{number}" for number in (9, 4)]
    assert html.index("Mean env steps") < html.index('class="stills"') < html.index('class="maps"')
    thumbnails = re.findall(r'class="thumbnail" href="([^"]+)"', browser.get("/submissions").text)
    assert f"/submissions/{COMPLETED.id}/episodes/{TASK}/4" in thumbnails
    data.stills.clear()
    assert "thumbnail" not in browser.get("/submissions").text
    assert 'class="stills"' not in browser.get(f"/submissions/{COMPLETED.id}").text
