import csv
import io
import re
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from typing import Any
from uuid import uuid4

import pytest
from asgi_browser import AsgiBrowser
from seeded_site import BEARS, DONE, GELBOTS, ORGANIZERS, SeededSite, form_token, words
from service_factories import LOCK, TASK, add_result, make_score, sha256, submit_scored
from sqlalchemy import update
from submission_steps import make_worker
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.database.models import EpisodeDifference, Shard, Submission, Team
from vitac.server.errors import TRACK_REMOVED
from vitac.server.leaderboards.public_pages import set_public
from vitac.web.pages.submissions import submissions
from vitac.web.plots.map import EpisodeMap, episode_map


def rows_of(browser: AsgiBrowser, path: str) -> list[dict[str, str]]:
    """The rows of a CSV file."""
    return list(csv.DictReader(io.StringIO(browser.get(path).text)))


def page(site: SeededSite, name: str, by: str = GELBOTS) -> str:
    """The words of a submission's page."""
    return words(site.visitor(by).get(site.path_of(name)).text)


def test_a_team_lists_its_own_submissions_and_an_organizer_all_with_their_teams(site: SeededSite) -> None:
    own, all_teams = (site.visitor(name).get("/submissions").text for name in (GELBOTS, ORGANIZERS))
    assert ("runs" in own, "waits" in own) == (True, False)
    assert ("runs" in all_teams, "waits" in all_teams, "Bears" in all_teams) == (True, True, True)


def test_older_submissions_are_linked(site: SeededSite) -> None:
    before = datetime.now(UTC) - timedelta(days=1)
    with site.database.transaction() as session:
        team = session.get_one(Team, site.seed.people[BEARS].team_id)
        for number in range(50):
            add_result(session, number, team, {TASK: make_score(number, 270)}, before - timedelta(minutes=number))
    browser = site.visitor(BEARS)
    (older,) = re.findall(r'href="(/submissions\?before=[^"]+)"', browser.get("/submissions").text)
    assert [row["submission"] for row in rows_of(browser, "/submissions.csv")][-1] == "49", "a file has them all"
    shown = words(browser.get(older).text)
    assert ("48" in shown, "49" in shown, "waits" in shown) == (True, True, False)


def test_page_of_a_remote_policy_says_what_its_result_proves(site: SeededSite) -> None:
    path = site.submit(GELBOTS, "remote", DONE)
    with site.evaluation("remote") as (_, evaluation):
        evaluation.submission.kind = SubmissionKind.REMOTE
    html = site.visitor(GELBOTS).get(path).text
    assert "This proves the actions, not which program or person chose them." in html
    assert "<code>vitac evaluate --remote</code>" in html


def test_foreign_and_missing_submissions_look_alike(site: SeededSite) -> None:
    browser = site.visitor(GELBOTS)
    for path in (site.path_of("waits"), f"/submissions/{uuid4()}", "/submissions/not-an-id"):
        for answer in (browser.get(path), browser.get(f"{path}/events")):
            assert answer.status_code == 404
            assert "Page not found" in answer.text
        assert browser.post(f"{path}/cancel", data={"form_token": form_token(browser)}).status_code == 404


def test_running_submission_updates_itself_with_and_without_script(site: SeededSite) -> None:
    browser, path = site.visitor(GELBOTS), site.path_of("runs")
    html = browser.get(path).text
    assert "137 of 270" in html
    assert f'data-events="{path}/events"' in html
    assert '<noscript><meta http-equiv="refresh" content="5"></noscript>' in html
    assert "http-equiv" not in browser.get(f"{path}?refresh=off").text


def test_the_map_of_a_completed_evaluation_is_drawn_once_and_that_of_a_running_one_each_time(
    site: SeededSite, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[str] = []

    def draw(track: str, task: str, *ends: Any, **more: Any) -> EpisodeMap:
        drawn.append(task)
        return episode_map(track, task, *ends, **more)

    monkeypatch.setattr(submissions, "episode_map", draw)
    browser, path = site.visitor(GELBOTS), site.submit(GELBOTS, "new", DONE)
    pages = [browser.get(path).text for _ in range(3)]
    assert len(drawn) == 1
    assert pages[0] == pages[1] == pages[2]
    assert pages[0].count(f'<a href="{path}/episodes/{TASK}/') == 270 + 4
    for _ in range(2):
        browser.get(site.path_of("runs"))
    assert len(drawn) == 3


def test_completed_submission_shows_its_score_stands_still_and_leads_to_an_episode_of_each_outcome(
    site: SeededSite,
) -> None:
    html = site.visitor(GELBOTS).get(site.path_of("done")).text
    shown = words(html)
    for text in ("86.7 %", "82.1 % to 90.2 %", "4.50", "a missing task counts as 0, which makes 43.3 %"):
        assert text in shown
    assert "Lock opening: not part of this submission" in shown
    for gone in ("data-events", "http-equiv", "Cancel this evaluation", "live.js", "/appeals?submission="):
        assert gone not in html
    ends = re.findall(r'<li>\d+ (\w+): ([^<]+) <a href="([^"]+)">Play episode (\d+)</a></li>', html)
    assert {outcome for outcome, *_ in ends} == {"success", "tactile", "steps", "error"}
    for outcome, sentence, address, episode in ends:
        assert sentence == EpisodeOutcome(outcome).sentence
        assert address == f"{site.path_of('done')}/episodes/{TASK}/{episode}"
        assert f'<a href="{address}"><title>Episode {episode},' in html


def test_a_submission_of_two_tasks_shows_each_with_rank_and_hash(site: SeededSite) -> None:
    html = site.visitor(GELBOTS).get(site.path_of("both")).text
    shown = words(html)
    with site.evaluation("both") as (_, evaluation):
        hashes = [score["result_hash"] for score in evaluation.scores or ()]
    for text in ("73.3 %", "86.7 %", "60.0 %", "96 of 160", *hashes):
        assert text in shown
    assert f'?task={LOCK}">1 of 2' in html
    assert "not part of this submission" not in shown
    assert html.index('id="task-peg-insertion"') < html.index("Trapezoid") < html.index('id="task-lock-opening"')
    assert 'aria-label="Key4: ' in html


@pytest.mark.parametrize(
    ("tasks", "says"),
    [
        (
            ("sensor-standard", "sensor-blind"),
            "Completed Own policy: not part of this submission. Without it there is no",
        ),
        (("sensor-design", "sensor-standard", "sensor-blind"), "Success rate 44.4 % 40 of 90 in Own policy"),
    ],
)
def test_a_sensor_has_a_rate_of_all_tasks_only_with_a_policy_of_its_own(
    tasks: tuple[str, ...], says: str, site: SeededSite
) -> None:
    """Of Track 3 the own policy alone counts."""
    with site.database.transaction() as session:
        scores = {task: make_score(40 + number, 90) for number, task in enumerate(tasks)}
        site.added["gel"] = submit_scored(session, site.seed.people[GELBOTS], "gel", scores, track="track_3").id
    assert says in page(site, "gel")


def test_a_submission_of_a_removed_track_shows_the_score_that_is_kept(site: SeededSite) -> None:
    with site.database.transaction() as session:
        for name in ("both", "broke"):
            set_public(session, site.seed.people[GELBOTS], site.id_of(name), public=True)
        session.execute(update(Submission).values(track="chess"))
    for by, is_own in ((BEARS, False), (GELBOTS, True)):
        answer = site.visitor(by).get(site.path_of("both"))
        assert answer.status_code == 410
        assert f"{TRACK_REMOVED} It played peg insertion, lock opening of <code>chess</code>." in answer.text
        assert "234 of 270" in answer.text
        assert "96 of 160" in answer.text
        assert ("Signed receipt" in answer.text) == is_own
        assert "/tracks/chess" not in answer.text, "it leads nowhere"
    answer = site.visitor(GELBOTS).get(site.path_of("broke"))
    assert (answer.status_code, "It has no score." in answer.text) == (410, True)


def test_failed_submission_shows_verdict_and_escaped_output(site: SeededSite) -> None:
    html = site.visitor(GELBOTS).get(site.path_of("broke")).text
    for shown in (
        "The policy raised or its process ended",
        "crashed",
        "lock opening, episode 4",
        "&lt;script&gt;alert(4)&lt;/script&gt;",
    ):
        assert shown in html
    assert "<script>alert" not in html


@pytest.mark.parametrize(("memory", "is_told"), [("watchdog", True), ("cgroup-v2", False)])
def test_a_result_without_a_control_group_is_shown_as_isolated_more_weakly(
    site: SeededSite, memory: str, is_told: bool
) -> None:
    level = f"user: root, memory: {memory}, episodes: frozen-copy, process ids repeat: True"
    site.submit(GELBOTS, "new", DONE)
    with site.evaluation("new") as (session, evaluation):
        session.execute(update(Shard).where(Shard.evaluation_id == evaluation.id).values(isolation=level))
    shown = page(site, "new")
    assert ("Weaker than usual" in shown) is is_told
    assert "Where process ids repeat, that of an episode does not show how many there were before." in shown


def test_packages_of_each_kind_of_worker_are_told_short_and_in_full(site: SeededSite) -> None:
    with site.evaluation("done") as (_, evaluation):
        evaluation.packages = [
            {"msgspec": "1", "numpy": "2.5", "torch": "2.13+cpu"},
            {"msgspec": "1", "numpy": "2.5"},
            {"<b>": "1"},
        ]
    parts = site.visitor(GELBOTS).get(site.path_of("done")).text.split("<dt>Packages</dt>")[1:]
    summaries = [part.partition("<summary>")[2].partition("</summary>")[0] for part in parts]
    assert summaries == ["numpy 2.5, torch 2.13+cpu, 3 in all", "numpy 2.5, 2 in all", "1 in all"]
    assert "msgspec 1, numpy 2.5, torch 2.13+cpu<br>" in parts[0]
    assert "&lt;b&gt; 1" in parts[2]


def test_organizers_page_says_that_an_episode_was_played_again_with_another_result(site: SeededSite) -> None:
    with site.evaluation("runs") as (session, evaluation):
        session.add(
            EpisodeDifference(
                evaluation_id=evaluation.id,
                task=TASK,
                episode=7,
                stored_digest=sha256("1"),
                differing_digest=sha256("2"),
            )
        )
    shown = page(site, "runs", ORGANIZERS)
    assert "1 episode was played again with another result." in shown
    assert f"vitac admin evaluation show {evaluation.id}" in shown
    assert "played again" not in page(site, "runs")


@pytest.mark.parametrize(
    ("workers", "says"),
    [
        ([], "No worker is running. The evaluation continues as soon as a worker starts"),
        ([{"families": []}], "No running worker can play these tasks: none has what tactile needs."),
        ([{"evaluator_version": "1+other"}], "No running worker has evaluator "),
    ],
)
def test_a_submission_that_waits_says_its_place_and_what_workers_lack(
    site: SeededSite, workers: Iterable[dict[str, Any]], says: str
) -> None:
    for changes in workers:
        make_worker(site.database, **changes)
    shown = page(site, "waits", BEARS)
    assert "Next in the queue" in shown
    assert says in shown
    assert ("No worker is running" in shown) == (not workers)


def test_cancelling_needs_the_sessions_form_token_and_an_evaluation_that_is_open(site: SeededSite) -> None:
    browser, path = site.visitor(GELBOTS), site.path_of("runs")
    for fields in ({"other": "x"}, {"form_token": "00"}):
        assert browser.post(f"{path}/cancel", data=fields).status_code == 403
    assert "Cancelled" not in browser.get("/submissions").text
    assert browser.post(f"{path}/cancel", data={"form_token": form_token(browser)}).status_code == 303
    assert "Cancelled" in browser.get("/submissions").text
    again = browser.post(f"{path}/cancel", data={"form_token": form_token(browser)})
    assert (again.status_code, "is cancelled already" in words(again.text)) == (409, True)


def test_events_of_a_finished_evaluation_are_one_view_and_the_end(site: SeededSite) -> None:
    path = f"{site.path_of('done')}/events"
    assert site.visitor().get(path).status_code == 204, "it does not come back without a session"
    answer = site.visitor(GELBOTS).get(path)
    assert answer.headers["content-type"].startswith("text/event-stream")
    events = [line.removeprefix("event: ") for line in answer.text.splitlines() if line.startswith("event: ")]
    assert events == ["view", "end"]
    assert "86.7" in answer.text
