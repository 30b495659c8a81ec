"""A policy server that plays for a submission: asked when that arrives, ranked apart from models and logs."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gates import gate
from policy_servers import ACTION, Handler, openpi, packed, serving
from service_client import Service, make_archive, problem_of, running_service
from service_factories import TASK, TRACK, claim, play_all, shard_ids
from vitac.cli.client.remote import connected
from vitac.evaluator.shards.order import ShardOrder
from vitac.server.database.engine import Database
from vitac.server.database.models import Submission
from vitac.server.operations.remote_gate import find_team
from vitac.worker.shard_run import ShardRun
from vitac.worker.staging import SubmissionStage
from worker_fakes import FakeShards

from competitions import make_competition, open_now, put_in_place

HONEST = openpi(lambda _: packed({"actions": ACTION}))


def archive(address: str | None) -> bytes:
    """A submission that only describes a server."""
    named = "" if address is None else f", address: '{address}'"
    manifest = f"track: {TRACK}\ntasks: [{TASK}]\nname: from elsewhere\nremote: {{protocol: openpi{named}}}\n"
    return make_archive({"Track_1/submission.yaml": manifest})


def upload(database: Database, folder: Path, handler: Handler, *, allowed: bool = True, named: bool = True) -> Any:
    """The service, and its answer to a submission of a server with this handler."""
    with (
        serving(handler) as address,
        running_service(database, folder, remote_addresses=f"ws://other:1, {address}" if allowed else "") as service,
    ):
        answer = service.upload(archive(address if named else None))
        assert service.count("work") == (10 if answer.status_code == 202 else 0)
        return answer


def test_server_that_answers_is_queued_on_the_public_list_as_a_kind_of_its_own(
    database: Database, tmp_path: Path
) -> None:
    answer = upload(database, tmp_path, HONEST)
    assert answer.status_code == 202, answer.text
    assert answer.json()["kind"] == "remote"
    assert answer.json()["evaluation"]["list_kind"] == "public"


def test_answers_of_the_upload_are_on_the_model_card(database: Database, tmp_path: Path) -> None:
    wide = openpi(lambda _: packed({"actions": np.array([-0.5, 1.5, 0.25], np.float32)}))
    with serving(wide) as address, running_service(database, tmp_path, remote_addresses=address) as service:
        identity = service.upload(archive(address)).json()["id"]
        contents = service.get(f"/submissions/{identity}/card").json()["contents"]
    (answer,) = contents["blank_answers"]
    assert (answer["task"], answer["low"], answer["high"]) == (TASK, -0.5, 1.5)
    assert 0 < answer["answer_s"] < 10


@pytest.mark.parametrize(
    ("handler", "options", "words"),
    [
        (HONEST, {"allowed": False}, "this service asks none"),
        (HONEST, {"named": False}, "the policy server without an address play"),
        (openpi(lambda _: packed({"actions": np.zeros(2)})), {}, r"shape (2,), expected (3,)"),
        (openpi(lambda _: "Traceback: no GPU"), {}, "no GPU"),
    ],
)
def test_server_that_could_not_play_is_refused_before_anything_is_queued(
    database: Database, tmp_path: Path, handler: Handler, options: dict[str, bool], words: str
) -> None:
    problem = problem_of(upload(database, tmp_path, handler, **options), 422, "manifest_rejected")
    assert words in problem["detail"]


def test_worker_asks_the_address_while_it_is_allowed(database: Database, tmp_path: Path) -> None:
    with serving(HONEST) as address, running_service(database, tmp_path, remote_addresses=address) as service:
        identity = service.upload(archive(address)).json()["id"]
        assert _order(service, identity, 0) == [address]
        forbidding = service.services.settings.model_copy(update={"remote_addresses": ""})
        assert _order(service, identity, 1, settings=forbidding) == []


def test_stage_may_give_a_server_less_time_for_an_answer_than_people_need(database: Database, tmp_path: Path) -> None:
    content = make_competition()
    content["tracks"][TRACK]["stages"][0] |= {"accepts": ["remote"], "answer_s": 0.5}
    with serving(HONEST) as address, running_service(database, tmp_path, remote_addresses=address) as service:
        with service.database.transaction() as session:
            put_in_place(session, open_now(content))
        identity = service.upload(archive(address)).json()["id"]
        (order,) = _orders(service, identity, 0)
        assert order.limits.action_wall_s == 0.5
        assert order.limits.start_wall_s == service.services.settings.limits.start_wall_s


def _order(service: Service, identity: str, number: int, **changes: Any) -> list[str | None]:
    """The addresses that the process of a shard is given; none where it is not started."""
    return [order.remote for order in _orders(service, identity, number, **changes)]


def _orders(service: Service, identity: str, number: int, **changes: Any) -> list[ShardOrder]:
    services = replace(service.services, **changes)
    with service.database.transaction() as session:
        shard = shard_ids(session, session.get_one(Submission, identity))[number]
    stage, shards = (
        SubmissionStage(services.blobs, services.settings.scratch_dir, services.settings.limits),
        FakeShards(),
    )
    try:
        ShardRun(services, stage, claim(services.database, shard), shards).run()
    finally:
        stage.close()
    return [started.order for started in shards.started]


def test_policy_that_dials_in_is_tried_at_the_upload_and_asked_through_the_gate(
    database: Database, tmp_path: Path
) -> None:
    find = partial(find_team, database)
    with gate(find=find) as (policies, players), running_service(database, tmp_path, remote_gate=players) as service:
        with serving(HONEST) as server, connected(policies, service.token, server, lines=1):
            answer = service.upload(archive("connect"))
            assert answer.status_code == 202, answer.text
        assert _order(service, answer.json()["id"], 0) == [f"{players}/play/Team%20A"]
        other = service.services.settings.model_copy(update={"remote_gate": ""})
        assert _order(service, answer.json()["id"], 1, settings=other) == []


def test_remote_play_has_a_board_of_its_own_that_says_what_it_is_worth(database: Database, tmp_path: Path) -> None:
    with serving(HONEST) as address, running_service(database, tmp_path, remote_addresses=address) as service:
        identity = service.upload(archive(address)).json()["id"]
        with service.database.transaction() as session:
            submission = session.get_one(Submission, identity)
        play_all(service.database, submission)
        found = service.get(f"/leaderboards/{TRACK}/logs").json()["boards"]
        boards = {(board["kind"], board["task"]): board for board in found}
        entry, label = boards["remote", TASK]["entries"][0], boards["remote", TASK]["label"]
        assert (entry["submission_id"], entry["rank"], entry["verdict"]) == (identity, 1, None)
        assert label == "played in our physics, policy not seen"
        assert boards["log", TASK]["entries"] == []
        assert service.get(f"/leaderboards/{TRACK}").json()["entries"] == []
