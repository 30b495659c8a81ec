"""Two workers and two servers that have only a database and a bucket in common, as on machines of their own."""

import json
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
import psycopg
import pytest
import short_evaluation
from databases import fresh_database, state_directory
from honest_policy import HONEST
from s3_server import s3_server
from service_client import API, bearer
from service_factories import TASK, TRACK
from short_evaluation import EPISODES
from worker_fakes import eventually

pytestmark = pytest.mark.slow

MAIN = "from vitac.cli.main import main; main()"
SERVE = f"import short_evaluation; short_evaluation.shorten(); {MAIN}"
N_WORKERS, N_SERVERS = 2, 2
LIMIT_S = 240.0


@dataclass(kw_only=True)
class Machines:
    """Processes with a state directory each, until a stack ends them; `common` is all that they share."""

    common: dict[str, str]
    servers: list[str] = field(default_factory=list)

    def start_server(self, stack: ExitStack) -> tuple[str, int]:
        """Address and process id of a new server."""
        process = self._start(stack, "-c", SERVE, "serve", "--port", "0", stdout=subprocess.PIPE)
        assert process.stdout is not None
        stack.callback(process.stdout.close)
        return process.stdout.readline().split()[-1], process.pid

    def start_worker(self, stack: ExitStack) -> None:
        self._start(stack, short_evaluation.__file__)

    def _start(self, stack: ExitStack, *arguments: str, **options: Any) -> "subprocess.Popen[str]":
        folder = state_directory()
        here = {"VITAC_STATE_DIR": str(folder / "state"), "PYTHONPATH": str(Path(short_evaluation.__file__).parent)}
        process = subprocess.Popen(
            [sys.executable, *arguments], env=os.environ | self.common | here, cwd=folder, text=True, **options
        )
        stack.callback(process.wait)
        stack.callback(process.terminate)
        return process

    def ready_workers(self) -> int:
        """How many workers the last server knows of."""
        ready: int = httpx.get(f"{self.servers[-1]}/ready", timeout=60).json()["workers"]["alive"]
        return ready

    def busy_workers(self) -> list[int]:
        """Process ids of the workers that hold a shard."""
        query = "SELECT pid FROM workers JOIN work ON work.worker_id = workers.id WHERE work.state = 'running'"
        with psycopg.connect(self.common["VITAC_DATABASE_URL"]) as connection:
            return [pid for (pid,) in connection.execute(query)]

    def submit(self, server: str, team: str) -> tuple[str, str]:
        """Submits for a new team; path of the submission and the team's token."""
        registered = httpx.post(f"{server}{API}/teams", json={"name": team}, timeout=60)
        token = registered.json()["token"]["secret"]
        headers = bearer(token) | {"Content-Type": "application/zip"}
        submitted = httpx.post(f"{server}{API}/submissions", content=HONEST, headers=headers, timeout=60)
        assert submitted.status_code == 202, submitted.text
        return f"{API}/submissions/{submitted.json()['id']}", token

    def get(self, server: str, path: str, token: str) -> Any:
        answer = httpx.get(f"{server}{path}", headers=bearer(token), timeout=60)
        answer.raise_for_status()
        return answer.json()


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machines]:
    """Servers for both tests in any order; what a test kills it starts itself."""
    with ExitStack() as stack:
        s3 = stack.enter_context(s3_server(tmp_path_factory.mktemp("s3")))
        address = stack.enter_context(fresh_database())
        quick = {"VITAC_LEASE_S": "3", "VITAC_LEASE_RENEWAL_S": "0.8", "VITAC_SWEEP_INTERVAL_S": "1"}
        common = {"VITAC_DATABASE_URL": address, "VITAC_SESSION_KEY": "the same everywhere", **s3.environment, **quick}
        machines = Machines(common=common)
        for _ in range(N_SERVERS):
            machines.servers.append(machines.start_server(stack)[0])
        yield machines


def test_servers_share_sessions_and_show_the_same_metrics(machines: Machines) -> None:
    added = subprocess.run(
        [sys.executable, "-c", MAIN, "admin", "token", "add", "--organizer", "--json"],
        env=os.environ | machines.common,
        capture_output=True,
        text=True,
        check=True,
    )
    token = json.loads(added.stdout)["secret"]
    signed_in = httpx.post(f"{machines.servers[0]}/sign-in", data={"token": token}, timeout=60)
    assert signed_in.status_code == 303
    page = httpx.get(f"{machines.servers[1]}/operations", cookies=signed_in.cookies, timeout=60)
    assert page.status_code == 200
    path, owner = machines.submit(machines.servers[0], "Team of the past")
    for address in machines.servers:
        figures = httpx.get(f"{address}/metrics", headers=bearer(token), timeout=60).text
        assert 'vitac_evaluations{state="queued"} 1.0' in figures
    cancelled = httpx.post(f"{machines.servers[1]}{path}/cancel", headers=bearer(owner), timeout=60)
    assert cancelled.json()["evaluation"]["state"] == "cancelled"


def test_what_one_machine_takes_all_evaluate_and_any_shows_although_some_are_killed(
    machines: Machines, undisturbed_hash: str
) -> None:
    other = machines.servers[-1]
    with ExitStack() as stack:
        server, server_pid = machines.start_server(stack)
        for _ in range(N_WORKERS):
            machines.start_worker(stack)
        eventually(lambda: machines.ready_workers() == N_WORKERS, LIMIT_S)
        path, token = machines.submit(server, "Team A")
        busy: set[int] = set()

        def is_busy() -> bool:
            busy.update(machines.busy_workers())
            return bool(busy)

        eventually(is_busy, LIMIT_S)
        for pid in (server_pid, min(busy)):
            os.kill(pid, signal.SIGKILL)
        eventually(lambda: machines.get(other, path, token)["evaluation"]["finished_at"] is not None, LIMIT_S)
    evaluation = machines.get(other, path, token)["evaluation"]
    assert (evaluation["state"], evaluation["verdict"]) == ("completed", None)
    assert evaluation["progress"]["episodes_done"] == len(EPISODES)
    assert evaluation["result_hash"] == undisturbed_hash
    board = machines.get(other, f"{API}/leaderboards/{TRACK}?task={TASK}", token)
    assert [entry["result_hash"] for entry in board["entries"]] == [undisturbed_hash]
