"""Hostile submissions go through the whole service beside an honest one, whose result must not change."""

from typing import Any

import pytest
from honest_policy import HONEST
from service_client import Service, make_archive
from service_factories import TRACK
from short_evaluation import StartWorker
from worker_fakes import eventually

LIMIT_S = 240.0
FRAME = """
import os, sys, time
import numpy as np

{at_import}

class Policy:
    def reset(self, task):
        pass

    def act(self, observation):
        {in_act}
        return np.zeros(3, np.float32)
"""

FORK_UNTIL_REFUSED = """
        try:
            while True:
                os.fork()
        except OSError:
            time.sleep(600)
"""
EAT_MEMORY = "kept = [b'x' * (1 << 26) for _ in range(99)]"

HOSTILE = {
    "crashed": FRAME.format(at_import="", in_act="raise RuntimeError('on purpose')"),
    "import_error": FRAME.format(at_import="import no_such_module", in_act="pass"),
    "wall_time": FRAME.format(at_import="", in_act="time.sleep(600)"),
    "output_flood": FRAME.format(at_import="", in_act="\n        while True: os.write(1, b'x' * 65536)"),
    "too_many_processes": FRAME.format(at_import="", in_act=FORK_UNTIL_REFUSED),
    "out_of_memory": FRAME.format(at_import="", in_act=EAT_MEMORY),
    "non_finite_action": FRAME.format(at_import="", in_act="return np.full(3, np.nan, np.float32)"),
    "bad_action_shape": FRAME.format(at_import="", in_act="return np.zeros(4, np.float32)"),
    "bad_action_type": FRAME.format(at_import="import pickle", in_act="return pickle.dumps([0, 0, 0])"),
}
"""Policies by the verdict that they have to meet."""


@pytest.fixture
def small_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limits that are met soon. The workers get them through the environment."""
    monkeypatch.setenv("VITAC_LIMITS__ACTION_WALL_S", "6")
    monkeypatch.setenv("VITAC_LIMITS__MEMORY_BYTES", str(256 << 20))


def upload(live: Service, archive: bytes, token: str) -> str:
    answer = live.upload(archive, token)
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def evaluation(live: Service, submission: str, token: str) -> dict[str, Any]:
    found: dict[str, Any] = live.get(f"/submissions/{submission}", token).json()["evaluation"]
    return found


@pytest.mark.slow
def test_hostile_policies_meet_their_verdicts_and_leave_other_teams_and_the_server_alone(
    small_limits: None, live: Service, start_worker: StartWorker, undisturbed_hash: str
) -> None:
    hostile = {code: upload(live, make_archive(policy=policy), live.other_token) for code, policy in HOSTILE.items()}
    honest = upload(live, HONEST, live.token)
    late = upload(live, make_archive(policy=f"{HOSTILE['crashed']}\n# again"), live.other_token)
    for _ in range(2):
        start_worker()
    everything = [(submission, live.other_token) for submission in (*hostile.values(), late)] + [(honest, live.token)]
    for submission, token in everything:
        eventually(lambda s=submission, t=token: evaluation(live, s, t)["finished_at"] is not None, LIMIT_S)  # type: ignore[misc]
    verdicts = {code: evaluation(live, submission, live.other_token)["verdict"] for code, submission in hostile.items()}
    assert {code: verdict["code"] for code, verdict in verdicts.items()} == {code: code for code in HOSTILE}
    assert "on purpose" in evaluation(live, hostile["crashed"], live.other_token)["log_tail"]
    done = evaluation(live, honest, live.token)
    assert (done["state"], done["result_hash"]) == ("completed", undisturbed_hash)
    board = live.client.get(f"/api/v1/leaderboards/{TRACK}").json()
    assert [entry["submission_id"] for entry in board["entries"]] == [honest]
    assert live.client.get("/ready").json()["status"] == "ready"
