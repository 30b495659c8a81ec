"""Kills a part of the service in the middle of an evaluation; the result has to be that of an undisturbed one."""

import os
import signal
import subprocess
from pathlib import Path
from typing import Any

from honest_policy import HONEST
from service_client import Service
from service_factories import TRACK, make_record
from short_evaluation import EPISODES, StartWorker
from uploaded_logs import EPISODES as LISTED
from uploaded_logs import a_log, upload_log
from vitac.evaluator.evaluation import Evaluation
from worker_fakes import eventually

LIMIT_S = 240.0


def submit(live: Service) -> str:
    answer = live.upload(HONEST)
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def evaluation(live: Service, submission: str) -> dict[str, Any]:
    found: dict[str, Any] = live.get(f"/submissions/{submission}").json()["evaluation"]
    return found


def wait_for_episodes(live: Service, submission: str, at_least: int) -> None:
    eventually(lambda: evaluation(live, submission)["progress"]["episodes_done"] >= at_least, LIMIT_S)
    assert evaluation(live, submission)["finished_at"] is None, "too late: the evaluation is over"


def assert_same_result(live: Service, submission: str, undisturbed_hash: str) -> None:
    eventually(lambda: evaluation(live, submission)["finished_at"] is not None, LIMIT_S)
    final = evaluation(live, submission)
    assert (final["state"], final["verdict"]) == ("completed", None)
    assert final["progress"]["episodes_done"] == len(EPISODES)
    assert final["result_hash"] == undisturbed_hash


def test_server_and_local_evaluation_give_the_same_hash(
    live: Service, start_worker: StartWorker, undisturbed_hash: str
) -> None:
    submission = submit(live)
    start_worker()
    assert_same_result(live, submission, undisturbed_hash)
    board = live.get(f"/leaderboards/{TRACK}").json()
    assert [(entry["rank"], entry["team"], entry["result_hash"]) for entry in board["entries"]] == [
        (1, "Team A", undisturbed_hash)
    ]


def test_two_workers_give_the_same_hash(live: Service, start_worker: StartWorker, undisturbed_hash: str) -> None:
    submission = submit(live)
    start_worker()
    start_worker()
    assert_same_result(live, submission, undisturbed_hash)


def test_kill_of_the_worker_in_the_middle_changes_nothing(
    live: Service, start_worker: StartWorker, undisturbed_hash: str
) -> None:
    submission = submit(live)
    first = start_worker()
    wait_for_episodes(live, submission, 2)
    first.send_signal(signal.SIGKILL)
    first.wait()
    start_worker()
    assert_same_result(live, submission, undisturbed_hash)


def test_kill_of_the_database_in_the_middle_changes_nothing(
    live: Service, start_worker: StartWorker, undisturbed_hash: str
) -> None:
    submission = submit(live)
    start_worker()
    wait_for_episodes(live, submission, 2)
    postgres = live.services.postgres
    assert postgres is not None
    killed = postgres.server_pid
    assert killed is not None
    os.kill(killed, signal.SIGKILL)
    eventually(lambda: postgres.server_pid not in (None, killed))
    eventually(lambda: live.client.get("/ready").status_code == 200)
    assert_same_result(live, submission, undisturbed_hash)


def test_kill_of_the_shards_own_process_in_the_middle_changes_nothing(
    live: Service, start_worker: StartWorker, undisturbed_hash: str
) -> None:
    submission = submit(live)
    worker = start_worker()
    wait_for_episodes(live, submission, 2)
    os.kill(child_of(worker, "vitac.evaluator.shard_process"), signal.SIGKILL)
    assert_same_result(live, submission, undisturbed_hash)


def test_stopped_worker_leaves_the_rest_to_the_next_one(
    live: Service, start_worker: StartWorker, undisturbed_hash: str
) -> None:
    submission = submit(live)
    first = start_worker()
    wait_for_episodes(live, submission, 2)
    first.terminate()
    assert first.wait(30.0) == 0
    eventually(lambda: live.get(f"/submissions/{submission}").json()["workers"]["alive"] == 0)
    start_worker()
    assert_same_result(live, submission, undisturbed_hash)


def child_of(process: "subprocess.Popen[bytes]", module: str) -> int:
    found: list[int] = []

    def look() -> bool:
        for status in Path("/proc").glob("[0-9]*/status"):
            try:
                parent = f"\nPPid:\t{process.pid}\n" in status.read_text()
                command = status.with_name("cmdline").read_bytes().decode().split("\0")
            except (FileNotFoundError, ProcessLookupError):
                continue
            if parent and module in command:
                found.append(int(status.parent.name))
        return bool(found)

    eventually(look)
    return found[0]


def test_kill_of_the_worker_in_the_middle_of_a_log_changes_nothing(
    live: Service, start_worker: StartWorker, undisturbed: Evaluation
) -> None:
    """Only the short list is re-simulated; the other episodes, which a log must hold, are made up."""
    played = {record.episode: record for record in undisturbed.records}
    log = a_log([played.get(episode, make_record(episode)) for episode in LISTED], **dict(undisturbed.manifest))
    answer = upload_log(live, log)
    assert answer.status_code == 202, answer.text
    submission = str(answer.json()["id"])
    first = start_worker()
    wait_for_episodes(live, submission, 2)
    first.send_signal(signal.SIGKILL)
    first.wait()
    start_worker()
    assert undisturbed.result_hash is not None
    assert_same_result(live, submission, undisturbed.result_hash)
    boards = live.get(f"/leaderboards/{TRACK}/logs").json()["boards"]
    assert [entry["result_hash"] for entry in boards[0]["entries"]] == [undisturbed.result_hash]
