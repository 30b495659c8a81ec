"""Kills a worker in the middle of an evaluation; the result has to be that of an undisturbed one.

`tests/chaos/run.py` kills everything else, too.
"""

from dataclasses import dataclass
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


def begun(live: Service, answer: Response, undisturbed_hash: str) -> Attempt:
    assert answer.status_code == 202, answer.text
    return Attempt(live=live, submission=answer.json()["id"], undisturbed_hash=undisturbed_hash)


@pytest.mark.slow
def test_kill_of_the_worker_in_the_middle_changes_nothing(
    live: Service, start_worker: StartWorker, undisturbed_hash: str
) -> None:
    attempt = begun(live, live.upload(HONEST), undisturbed_hash)
    worker = start_worker()
    attempt.wait_for_episodes(2)
    worker.kill()
    worker.wait()
    start_worker()
    attempt.assert_same_result()
    board = live.get(f"/leaderboards/{TRACK}").json()
    assert [(entry["rank"], entry["team"], entry["result_hash"]) for entry in board["entries"]] == [
        (1, "Team A", undisturbed_hash)
    ]


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
    worker.kill()
    worker.wait()
    start_worker()
    attempt.assert_same_result()
    boards = live.get(f"/leaderboards/{TRACK}/logs").json()["boards"]
    assert [entry["result_hash"] for entry in boards[0]["entries"]] == [undisturbed_hash]
