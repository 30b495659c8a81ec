"""Three workers and two servers that have only a database and a bucket in common, as on machines of their own."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest
import short_evaluation
from databases import fresh_database, state_directory
from honest_policy import HONEST
from s3_server import s3_server
from service_client import API, bearer
from service_factories import TASK, TRACK
from short_evaluation import EPISODES
from worker_fakes import eventually

SERVE = "import short_evaluation; short_evaluation.shorten(); from vitac.cli.main import main; main()"
N_WORKERS, N_SERVERS = 3, 2
LIMIT_S = 240.0


@dataclass(kw_only=True)
class Machines:
    """Processes with a state directory each; `common` is all that they share."""

    common: dict[str, str]
    stack: ExitStack
    servers: list[str] = field(default_factory=list)
    server_processes: list["subprocess.Popen[str]"] = field(default_factory=list)
    workers: list["subprocess.Popen[str]"] = field(default_factory=list)

    def start_server(self) -> None:
        process = self._start("-c", SERVE, "serve", "--port", "0", stdout=subprocess.PIPE)
        assert process.stdout is not None
        self.stack.callback(process.stdout.close)
        self.servers.append(process.stdout.readline().split()[-1])
        self.server_processes.append(process)

    def start_worker(self) -> None:
        self.workers.append(self._start(short_evaluation.__file__))

    def _start(self, *arguments: str, **options: Any) -> "subprocess.Popen[str]":
        folder = state_directory()
        here = {"VITAC_STATE_DIR": str(folder / "state"), "PYTHONPATH": str(Path(short_evaluation.__file__).parent)}
        process = subprocess.Popen(
            [sys.executable, *arguments], env=os.environ | self.common | here, cwd=folder, text=True, **options
        )
        self.stack.callback(process.wait)
        self.stack.callback(process.terminate)
        return process

    def get(self, server: int, path: str, token: str) -> Any:
        answer = httpx.get(f"{self.servers[server]}{path}", headers=bearer(token), timeout=30)
        answer.raise_for_status()
        return answer.json()


@pytest.fixture
def machines(tmp_path: Path) -> Iterator[Machines]:
    with ExitStack() as stack:
        s3 = stack.enter_context(s3_server(tmp_path))
        address = stack.enter_context(fresh_database())
        quick = {"VITAC_LEASE_S": "3", "VITAC_LEASE_RENEWAL_S": "0.3", "VITAC_SWEEP_INTERVAL_S": "0.3"}
        common = {"VITAC_DATABASE_URL": address, "VITAC_SESSION_KEY": "the same everywhere", **s3.environment, **quick}
        machines = Machines(common=common, stack=stack)
        for _ in range(N_SERVERS):
            machines.start_server()
        for _ in range(N_WORKERS):
            machines.start_worker()
        yield machines


def test_what_one_machine_takes_all_evaluate_and_any_shows_although_some_are_killed(
    machines: Machines, undisturbed_hash: str
) -> None:
    registered = httpx.post(f"{machines.servers[0]}{API}/teams", json={"name": "Team A"})
    token = registered.json()["token"]["secret"]
    eventually(lambda: machines.get(1, "/ready", token)["workers"]["alive"] == N_WORKERS, LIMIT_S)
    headers = bearer(token) | {"Content-Type": "application/zip"}
    submitted = httpx.post(f"{machines.servers[0]}{API}/submissions", content=HONEST, headers=headers, timeout=60)
    assert submitted.status_code == 202, submitted.text
    path = f"{API}/submissions/{submitted.json()['id']}"
    eventually(lambda: machines.get(1, path, token)["evaluation"]["progress"]["episodes_done"] >= 1, LIMIT_S)
    for process in (machines.server_processes[0], machines.workers[0]):
        process.send_signal(signal.SIGKILL)
    eventually(lambda: machines.get(1, path, token)["evaluation"]["finished_at"] is not None, LIMIT_S)
    evaluation = machines.get(1, path, token)["evaluation"]
    assert (evaluation["state"], evaluation["verdict"]) == ("completed", None)
    assert evaluation["progress"]["episodes_done"] == len(EPISODES)
    assert evaluation["result_hash"] == undisturbed_hash
    board = machines.get(1, f"{API}/leaderboards/{TRACK}?task={TASK}", token)
    assert [entry["result_hash"] for entry in board["entries"]] == [undisturbed_hash]
