"""Kills a part of the service in the middle of an evaluation; the result has to be that of an undisturbed one."""

import os
import signal
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from honest_policy import HONEST
from httpx import Response
from service_client import Service
from service_factories import TRACK, make_record
from short_evaluation import EPISODES, StartWorker
from uploaded_logs import EPISODES as LISTED
from uploaded_logs import a_log, upload_log
from vitac.evaluator.evaluation.local import LocalEvaluation
from worker_fakes import eventually

LIMIT_S = 240.0


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """An evaluation on a live service, and what it has to end with whatever happens meanwhile."""

    live: Service
    submission: str
    undisturbed_hash: str

    @property
    def evaluation(self) -> dict[str, Any]:
        found: dict[str, Any] = self.live.get(f"/submissions/{self.submission}").json()["evaluation"]
        return found

    def wait_for_episodes(self, at_least: int) -> None:
        eventually(lambda: self.evaluation["progress"]["episodes_done"] >= at_least, LIMIT_S)
        assert self.evaluation["finished_at"] is None, "too late: the evaluation is over"

    def assert_same_result(self) -> None:
        eventually(lambda: self.evaluation["finished_at"] is not None, LIMIT_S)
        final = self.evaluation
        assert (final["state"], final["verdict"]) == ("completed", None)
        assert final["progress"]["episodes_done"] == len(EPISODES)
        assert final["result_hash"] == self.undisturbed_hash


@pytest.fixture
def attempt(live: Service, undisturbed_hash: str) -> Attempt:
    """Submitted; no worker has been started."""
    return begun(live, live.upload(HONEST), undisturbed_hash)


def begun(live: Service, answer: Response, undisturbed_hash: str) -> Attempt:
    assert answer.status_code == 202, answer.text
    return Attempt(live=live, submission=answer.json()["id"], undisturbed_hash=undisturbed_hash)


@pytest.fixture
def worker(attempt: Attempt, start_worker: StartWorker) -> "subprocess.Popen[bytes]":
    """A worker in the middle of the evaluation."""
    process = start_worker()
    attempt.wait_for_episodes(2)
    return process


@pytest.mark.slow
def test_server_and_local_evaluation_give_the_same_hash(attempt: Attempt, start_worker: StartWorker) -> None:
    start_worker()
    attempt.assert_same_result()
    board = attempt.live.get(f"/leaderboards/{TRACK}").json()
    assert [(entry["rank"], entry["team"], entry["result_hash"]) for entry in board["entries"]] == [
        (1, "Team A", attempt.undisturbed_hash)
    ]


@pytest.mark.slow
def test_two_workers_give_the_same_hash(attempt: Attempt, start_worker: StartWorker) -> None:
    start_worker()
    start_worker()
    attempt.assert_same_result()


@pytest.mark.slow
def test_kill_of_the_worker_in_the_middle_changes_nothing(
    attempt: Attempt, worker: "subprocess.Popen[bytes]", start_worker: StartWorker
) -> None:
    worker.send_signal(signal.SIGKILL)
    worker.wait()
    start_worker()
    attempt.assert_same_result()


@pytest.mark.slow
@pytest.mark.parametrize("database_address", [None], ids=["embedded"])
@pytest.mark.usefixtures("worker")
def test_kill_of_the_database_in_the_middle_changes_nothing(attempt: Attempt) -> None:
    postgres = attempt.live.services.postgres
    assert postgres is not None
    killed = postgres.server_pid
    assert killed is not None
    os.kill(killed, signal.SIGKILL)
    eventually(lambda: postgres.server_pid not in (None, killed))
    eventually(lambda: attempt.live.client.get("/ready").status_code == 200)
    attempt.assert_same_result()


@pytest.mark.slow
def test_kill_of_the_shards_own_process_in_the_middle_changes_nothing(
    attempt: Attempt, worker: "subprocess.Popen[bytes]"
) -> None:
    os.kill(host_child_of(host_child_of(worker.pid)), signal.SIGKILL)
    attempt.assert_same_result()


@pytest.mark.slow
def test_kill_of_the_process_that_forks_shards_changes_nothing(
    attempt: Attempt, worker: "subprocess.Popen[bytes]"
) -> None:
    os.kill(host_child_of(worker.pid), signal.SIGKILL)
    attempt.assert_same_result()


@pytest.mark.slow
def test_stopped_worker_leaves_the_rest_to_the_next_one(
    attempt: Attempt, worker: "subprocess.Popen[bytes]", start_worker: StartWorker
) -> None:
    worker.terminate()
    assert worker.wait(120.0) == 0
    eventually(lambda: attempt.live.get(f"/submissions/{attempt.submission}").json()["workers"]["alive"] == 0)
    start_worker()
    attempt.assert_same_result()


@pytest.mark.slow
def test_kill_of_the_worker_in_the_middle_of_a_log_changes_nothing(
    live: Service, start_worker: StartWorker, undisturbed: LocalEvaluation, undisturbed_hash: str
) -> None:
    """Only the short list is re-simulated; the other episodes, which a log must hold, are made up."""
    played = {record.episode: record for record in undisturbed.records}
    log = a_log([played.get(episode, make_record(episode)) for episode in LISTED], **dict(undisturbed.manifest))
    attempt = begun(live, upload_log(live, log), undisturbed_hash)
    worker = start_worker()
    attempt.wait_for_episodes(2)
    worker.send_signal(signal.SIGKILL)
    worker.wait()
    start_worker()
    attempt.assert_same_result()
    boards = live.get(f"/leaderboards/{TRACK}/logs").json()["boards"]
    assert [entry["result_hash"] for entry in boards[0]["entries"]] == [undisturbed_hash]


def host_child_of(pid: int) -> int:
    """Wait for a child that holds the loaded simulation: the host below a worker, a shard below the host."""
    found: list[int] = []

    def look() -> bool:
        for status in Path("/proc").glob("[0-9]*/status"):
            try:
                parent = f"\nPPid:\t{pid}\n" in status.read_text()
                command = status.with_name("cmdline").read_bytes().decode().split("\0")
            except (FileNotFoundError, ProcessLookupError):
                continue
            if parent and "vitac.evaluator.shards.host" in command:
                found.append(int(status.parent.name))
        return bool(found)

    eventually(look)
    return found[0]
