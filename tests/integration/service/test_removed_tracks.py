"""A track, or a task of it, is removed while submissions of it remain: every route about them still has an answer."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from databases import opened_database
from fastapi import FastAPI
from httpx import Client, post
from own_track import OWN_TRACK
from served_pages import NO_CERTIFICATES, PageVisitor
from service_factories import make_principal, make_secret, make_settings, make_upload, outdate, play_all
from sqlalchemy import update
from sqlalchemy.orm import Session
from starlette.routing import Route
from vitac.cli.service.web_server import WebServer, bind, format_address
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.database.models import EpisodeResult, Submission
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.logs import LogClaim
from vitac.server.leaderboards import public_pages
from vitac.server.playbacks import asking
from vitac.server.principals import CONSOLE, Principal
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore
from vitac.server.submissions import creation
from vitac.web.application import create
from vitac.web.pages.routes import pages

pytestmark = pytest.mark.slow

SECOND = OWN_TRACK[OWN_TRACK.index("  own-pegs:") :].replace("own-pegs", "far-pegs")
BOTH = OWN_TRACK.replace("accepts:", "combination_rule: The mean of both.\naccepts:") + SECOND.removeprefix("\n")
REMOVED = {"track": BOTH.replace("pegs", "others"), "task": OWN_TRACK.replace("own-pegs", "far-pegs")}
"""What is left in the folder of track files."""
NAMES = ("done", "waits", "failed", "log")
EXAMPLES = {"task": "own-pegs", "track": "pegs", "number": "1", "file": "scene", "action": "none"}
SUBMISSION = "/submissions/{submission_id}"
EPISODE = f"{SUBMISSION}/episodes/{{task}}/{{number}}"
SHOWN_WITH_A_TRACK = (SUBMISSION, f"{SUBMISSION}/episodes.csv", f"{SUBMISSION}/episodes.json")
"""These need what the track file says, and say that it is gone; they show what is left where only a task is gone."""
LISTS = ("/", "/submissions", "/submissions.csv", "/team", "/api/v1/submissions")
"""These show other submissions, too, and go on."""


@dataclass(frozen=True, kw_only=True)
class RemainingSubmissions:
    """A service that was started again after the track file had changed, and what it still has of the track."""

    address: str
    app: FastAPI
    removed: str
    ids: dict[str, str]
    headers: dict[str, str]
    organizer: str

    def get(self, path: str, *, signed_in: bool = True) -> tuple[int, str]:
        """Status and text of an answer; of a stream of events the status only."""
        headers = self.headers if signed_in else {"accept": self.headers["accept"]}
        with (
            Client(base_url=self.address, trust_env=False, verify=NO_CERTIFICATES, headers=headers) as client,
            client.stream("GET", path) as answer,
        ):
            streamed = answer.headers.get("content-type", "").startswith("text/event-stream")
            return answer.status_code, "" if streamed else answer.read().decode("utf-8", "replace")


def submitted(session: Session, team: Principal, name: str, **changes: Any) -> Submission:
    upload = make_upload(name, track="pegs", tasks=changes.pop("tasks", ("own-pegs", "far-pegs")), name=name, **changes)
    return creation.create(session, team, upload)[0]


@pytest.fixture(scope="module", params=REMOVED)
def remaining(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[RemainingSubmissions]:
    folder, other = tmp_path_factory.mktemp("tracks"), tmp_path_factory.mktemp("left")
    settings = make_settings(state_dir=tmp_path_factory.mktemp("state"))
    (folder / "pegs.yaml").write_text(BOTH)
    left = REMOVED[request.param]
    (other / ("others.yaml" if "name: others" in left else "pegs.yaml")).write_text(left)
    with pytest.MonkeyPatch.context() as patch, opened_database() as database:
        patch.setenv("VITAC_TRACKS_DIR", str(folder))
        blobs = BlobStore.from_settings(settings)
        with database.transaction() as session:
            team = make_principal(session)
            secret, organizer = make_secret(session, team), make_secret(session, CONSOLE)
            claim = LogClaim(team=None, episodes=2, successes=2, success_rate=1.0, mean_steps=3.0).stored()
            from_log = {"kind": SubmissionKind.LOG, "manifest": claim, "tasks": ("own-pegs",)}
            made = {name: submitted(session, team, name, **(from_log if name == "log" else {})) for name in NAMES}
            ids = {name: str(submission.id) for name, submission in made.items()}
        play_all(database, made["done"])
        with database.transaction() as session:
            lifecycle.fail_by_machines(
                session, newest_evaluation(session, made["failed"]), "The disk of worker 1 broke."
            )
            public_pages.set_public(session, team, made["done"].id, public=True)
            asking.ask(session, settings, CONSOLE, asking.find_episode(session, team, made["done"].id, "own-pegs", 1))
            outdate(session)  # a track file that goes changes the evaluator's version
            session.execute(update(EpisodeResult).values(evaluator_version="0+old"))
        patch.setenv("VITAC_TRACKS_DIR", str(other))
        services = Services(settings=settings, database=database, blobs=blobs, postgres=None)
        app, listener = create(services), bind("127.0.0.1", 0)
        server = WebServer(app=app, listener=listener)
        server.start()
        visitor = PageVisitor(address=format_address(listener))
        assert visitor.post("/sign-in", data={"token": secret}).status_code == 303
        cookies = "; ".join(f"{name}={value}" for name, value in visitor.cookies.items())
        headers = {"accept": "text/html", "authorization": f"Bearer {secret}", "cookie": cookies}
        yield RemainingSubmissions(
            address=format_address(listener),
            app=app,
            removed=request.param,
            ids=ids,
            headers=headers,
            organizer=organizer,
        )
        server.stop()


def asked_of(remaining: RemainingSubmissions, name: str) -> dict[str, str]:
    """Addresses by route, of all that have examples for their parameters; those of no submission only once."""
    of_pages = [route.path for route in pages().routes if isinstance(route, Route) and "GET" in (route.methods or ())]
    of_api = [path for path, methods in remaining.app.openapi()["paths"].items() if "get" in methods]
    examples = EXAMPLES | {"submission_id": remaining.ids[name]}
    return {
        path: path.format_map(examples)
        for path in of_pages + of_api
        if set(re.findall(r"{(\w+)", path)) <= examples.keys() and ("{submission_id}" in path or name == "done")
    }


@pytest.mark.parametrize("name", NAMES)
def test_every_route_has_an_answer(remaining: RemainingSubmissions, name: str) -> None:
    found = {path: remaining.get(address)[0] for path, address in asked_of(remaining, name).items()}
    assert len(found) > 20
    assert {path: status for path, status in found.items() if status >= 500} == {}
    shown = 410 if remaining.removed == "track" else 200
    assert {path: found[path] for path in SHOWN_WITH_A_TRACK} == dict.fromkeys(SHOWN_WITH_A_TRACK, shown)
    assert {found[path] for path in LISTS if path in found} <= {200}


def test_visitors_without_a_session_get_answers_of_what_is_public(remaining: RemainingSubmissions) -> None:
    asked = asked_of(remaining, "done")
    found = {path: remaining.get(asked[path], signed_in=False)[0] for path in (*SHOWN_WITH_A_TRACK, EPISODE, "/")}
    assert max(found.values()) < 500, found
    asked_for = PageVisitor(address=remaining.address).post(f"{asked[EPISODE]}/playback", data={"beside": ""})
    assert asked_for.status_code in {404, 410}


def test_the_answer_says_what_is_gone(remaining: RemainingSubmissions) -> None:
    for path in SHOWN_WITH_A_TRACK if remaining.removed == "track" else (EPISODE,):
        status, text = remaining.get(asked_of(remaining, "done")[path])
        assert status == 410
        assert "This belongs to a track or task that this service no longer has." in text
        assert "pegs" in text


def test_results_are_what_they_were_with_all_that_does_not_need_the_task(remaining: RemainingSubmissions) -> None:
    address = f"/submissions/{remaining.ids['done']}"
    status, text = remaining.get(f"/api/v1{address}")
    evaluation = json.loads(text)["evaluation"]
    assert (status, evaluation["success_rate"], evaluation["mean_steps"]) == (200, 1.0, 3.0)
    assert (evaluation["counted_tasks"], evaluation["list_kind"]) == (["own-pegs", "far-pegs"], "public")
    assert not evaluation["episodes_hidden"]
    for task in ("own-pegs", "far-pegs"):
        assert remaining.get(f"/api/v1{address}/log?task={task}")[0] == 200
    if remaining.removed == "task":
        page = remaining.get(address)[1]
        assert "own pegs" in page
        assert "This service no longer has the task, so its episodes cannot be shown." in page
        assert f'href="{address}/episodes/far-pegs/1"' in page
        assert remaining.get(f"{address}/episodes/far-pegs/1")[0] == 200
        rows = json.loads(remaining.get(f"{address}/episodes.json")[1])
        starts = sorted((row["task"], row["start"]) for row in rows)
        assert starts == [("far-pegs", "1 2 3")] * 2 + [("own-pegs", "")] * 2


def test_lists_still_name_what_remains(remaining: RemainingSubmissions) -> None:
    text = remaining.get("/submissions")[1]
    assert all(submission_id in text for submission_id in remaining.ids.values())
    answer = remaining.get("/api/v1/submissions")[1]
    assert '"episodes_total":2' in answer


@pytest.mark.parametrize("remaining", ["track"], indirect=True)
@pytest.mark.parametrize("signed_in", [True, False])
def test_an_old_link_leads_to_the_score_that_is_kept(remaining: RemainingSubmissions, signed_in: bool) -> None:
    address = f"/submissions/{remaining.ids['done']}"
    status, text = remaining.get(address, signed_in=signed_in)
    assert (status, "Its score stays" in text, "2 of 2" in text) == (410, True, True)
    assert "own-pegs" in remaining.get(f"{address}/scores.csv", signed_in=signed_in)[1]


def test_what_waits_can_be_cancelled(remaining: RemainingSubmissions) -> None:
    page = f"/submissions/{remaining.ids['waits']}"
    assert f'action="{page}/cancel"' in remaining.get(page)[1]
    address = f"{remaining.address}/api/v1/submissions/{remaining.ids['waits']}/cancel"
    answer = post(address, headers=remaining.headers, verify=NO_CERTIFICATES, trust_env=False)
    assert answer.status_code == 200
    assert answer.json()["evaluation"]["state"] == "cancelled"
    assert f'action="{page}/cancel"' not in remaining.get(page)[1]


@pytest.mark.parametrize("remaining", ["track"], indirect=True)
def test_what_failed_says_why(remaining: RemainingSubmissions) -> None:
    text = remaining.get(f"/submissions/{remaining.ids['failed']}")[1]
    assert "It has no score." in text
    assert "The disk of worker 1 broke." in text


@pytest.mark.parametrize("address", ["submissions/{done}/requeue", "rejudgements"])
def test_what_is_gone_is_not_evaluated_again(remaining: RemainingSubmissions, address: str) -> None:
    asked = {"track": "pegs", "submissions": [remaining.ids["done"]], "reason": "a new evaluator"}
    answer = post(
        f"{remaining.address}/api/v1/{address.format_map(remaining.ids)}",
        json=asked if "rejudgements" in address else None,
        headers={"authorization": f"Bearer {remaining.organizer}"},
        verify=NO_CERTIFICATES,
        trust_env=False,
    )
    assert answer.status_code in {404, 410}, answer.text
    assert answer.json()["code"] in {"unknown_track", "track_removed"}
