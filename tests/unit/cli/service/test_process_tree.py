"""Several server processes at one socket behave as one: answers, limits, the end, the loss of one of them."""

import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from databases import fresh_database
from service_factories import claim, make_principal, make_secret, shard_ids, state_of, submit
from vitac.cli.service import process_tree
from vitac.cli.service.process_tree import ProcessPool
from vitac.server.database.engine import Database
from vitac.server.database.states import WorkState
from worker_fakes import eventually

SLEEPER = ("-c", "import time; time.sleep(600)")
STUBBORN = ("-c", "import signal, time; signal.signal(15, signal.SIG_IGN); print('deaf', flush=True); time.sleep(600)")


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.fixture
def notices() -> list[str]:
    return []


@pytest.fixture
def workers(notices: list[str]) -> Iterator[ProcessPool]:
    workers = ProcessPool(count=2, log=subprocess.DEVNULL, notify=notices.append, command=SLEEPER)
    yield workers
    workers.stop()


def test_starts_so_many_and_ends_them_all(workers: ProcessPool) -> None:
    workers.start()
    pids = workers.pids
    assert len(set(pids)) == 2
    assert all(alive(pid) for pid in pids)
    workers.stop()
    assert not any(alive(pid) for pid in pids)
    assert workers.pids == []


def test_one_that_was_killed_is_replaced(workers: ProcessPool, notices: list[str]) -> None:
    workers.start()
    killed, other = workers.pids
    subprocess.run(["kill", "-9", str(killed)], check=True)
    eventually(lambda: not alive(killed))
    workers.restart_ended()
    assert other in workers.pids
    assert killed not in workers.pids
    assert len(workers.pids) == 2
    assert notices == [f"worker {killed} ended with code -9; starting another one"]


def test_one_that_dies_at_once_is_not_started_over_and_over(
    notices: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process_tree, "RESTART_PAUSE_S", 3600.0)
    workers = ProcessPool(count=1, log=subprocess.DEVNULL, notify=notices.append, command=("-c", "raise SystemExit(3)"))
    workers.start()
    try:
        first = workers.pids[0]
        eventually(lambda: not alive(first))
        for _ in range(50):
            workers.restart_ended()
        second = workers.pids[0]
        eventually(lambda: not alive(second))
        for _ in range(50):
            workers.restart_ended()
        assert len(notices) == 1
    finally:
        workers.stop()


def test_one_that_does_not_listen_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_tree, "STOP_LIMIT_S", 0.2)
    with tempfile.TemporaryFile() as log:
        workers = ProcessPool(count=1, log=log.fileno(), notify=print, command=STUBBORN)
        workers.start()
        pid = workers.pids[0]
        eventually(lambda: log.tell() > 0 or _size(log.fileno()) > 0)
        workers.stop()
        assert not alive(pid)


def test_they_end_with_their_starter_even_when_it_is_killed() -> None:
    child = (
        "import os, sys, time\n"
        "from signal import SIGTERM; from vitac.evaluator.parent_death import end_with_parent\n"
        "end_with_parent(int(sys.argv[1]), SIGTERM); time.sleep(600)\n"
    )
    starter = (
        "import subprocess, time\n"
        "from vitac.cli.service.process_tree import ProcessPool\n"
        f"workers = ProcessPool(count=1, log=subprocess.DEVNULL, notify=print, command=('-c', {child!r}))\n"
        "workers.start(); print(workers.pids[0], flush=True); time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", starter], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        worker = int(process.stdout.readline())
        eventually(lambda: _asked_for_death_signal(worker))
        process.kill()
    eventually(lambda: not alive(worker))


def _asked_for_death_signal(pid: int) -> bool:
    """The child has come as far as its sleep: it has read its last import."""
    return "time" in Path(f"/proc/{pid}/cmdline").read_text() and _sleeps(pid)


def _sleeps(pid: int) -> bool:
    return "nanosleep" in Path(f"/proc/{pid}/wchan").read_text()


def _size(descriptor: int) -> int:
    import os

    return os.fstat(descriptor).st_size


pytestmark = pytest.mark.slow


SERVE = "from vitac.cli.main import main; main(['serve', '--port', '0'])"
TEAMS = "/api/v1/teams"


@dataclass(frozen=True, kw_only=True)
class Servers:
    """`vitac serve` with two server processes. Each request has a connection of its own."""

    process: "subprocess.Popen[str]"
    address: str
    database: Database

    @property
    def pids(self) -> list[int]:
        return [pid for pid in children_of(self.process.pid) if b"web_process" in command_of(pid)]

    def register(self, name: str) -> httpx.Response:
        return httpx.post(f"{self.address}{TEAMS}", json={"name": name}, timeout=60)

    @contextmanager
    def only(self, pid: int) -> Iterator[None]:
        """Has one process answer all requests; the other one is stopped meanwhile."""
        others = [other for other in self.pids if other != pid]
        for other in others:
            os.kill(other, signal.SIGSTOP)
        try:
            yield
        finally:
            for other in others:
                os.kill(other, signal.SIGCONT)


def children_of(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def command_of(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):  # it has just ended
        return b""


@pytest.fixture(scope="module")
def servers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Servers]:
    """For all tests, which leave two processes; `register` works for the first that takes it."""
    state = tmp_path_factory.mktemp("servers") / "state"
    limits = {"VITAC_REGISTRATIONS_PER_HOUR": "3", "VITAC_UPLOADS_AT_ONCE": "1", "VITAC_UPLOAD_IDLE_TIMEOUT_S": "300"}
    with fresh_database() as url:
        environment = os.environ | limits | {"VITAC_DATABASE_URL": url, "VITAC_STATE_DIR": str(state)}
        environment["VITAC_SERVER_PROCESSES"] = "2"
        with subprocess.Popen(
            [sys.executable, "-c", SERVE], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            address = process.stdout.readline().split()[-1]
            servers = Servers(process=process, address=address, database=Database(url))
            eventually(lambda: all_answer(servers))
            yield servers
            servers.database.dispose()
            process.send_signal(signal.SIGTERM)
            _, complaints = process.communicate(timeout=300)
        assert process.returncode == 0, complaints
        assert "Traceback" not in complaints


def all_answer(servers: Servers) -> bool:
    return len(servers.pids) == 2 and all(answers(servers, pid) for pid in servers.pids)


def answers(servers: Servers, pid: int) -> bool:
    with servers.only(pid):
        try:
            return httpx.get(f"{servers.address}/ready", timeout=10).is_success
        except httpx.TimeoutException:
            return False


def test_limits_count_for_all_processes_together(servers: Servers) -> None:
    one, other = servers.pids
    answers = []
    for number, pid in enumerate([one, other, one, other, one]):
        with servers.only(pid):
            answers.append(servers.register(f"Team {number}"))
    assert [answer.status_code for answer in answers] == [201, 201, 201, 429, 429]
    token = {"Authorization": f"Bearer {answers[0].json()['token']['secret']}", "Content-Type": "application/zip"}

    def upload(content: object, timeout: float = 60) -> httpx.Response:
        upload_to = f"{servers.address}/api/v1/submissions"
        return httpx.post(upload_to, content=content, headers=token, timeout=timeout)  # type: ignore[arg-type]

    second: list[httpx.Response] = []

    def other_refuses() -> bool:
        # One may be stopped while it holds the limit's lock.
        with servers.only(other), suppress(httpx.TimeoutException):
            second.append(upload(b"PK", timeout=10))
        return bool(second) and second[-1].status_code == 429

    def pieces() -> Iterator[bytes]:
        yield b"PK"
        eventually(other_refuses)  # once this upload has been taken
        yield b"PK"

    first = upload(pieces())
    assert first.status_code == 422
    assert "uploads at the same time" in second[-1].json()["detail"]


def test_a_process_that_waits_for_the_database_ends_at_once_with_its_starter(tmp_path: Path) -> None:
    """Else it would hold the port of a service whose other processes have ended."""
    with socket.socket() as listener, socket.create_server(("127.0.0.1", 0)) as silent:
        host, port = silent.getsockname()  # a database that takes connections and never answers
        environment = os.environ | {
            "VITAC_DATABASE_URL": f"postgresql://nobody@{host}:{port}/none",
            "VITAC_STATE_DIR": str(tmp_path),
        }
        listener.bind(("127.0.0.1", 0))
        with subprocess.Popen(
            [sys.executable, *process_tree.WEB_PROCESS_COMMAND, str(listener.fileno()), str(os.getpid())],
            env=environment,
            pass_fds=[listener.fileno()],
        ) as process:
            silent.settimeout(60.0)
            connection, _ = silent.accept()  # it waits for the database from here on
            process.terminate()
            assert process.wait(60.0) == -signal.SIGTERM
            connection.close()


def test_kill_of_one_process_leaves_the_service_answering_and_another_one_is_started(servers: Servers) -> None:
    killed, other = servers.pids
    os.kill(killed, signal.SIGKILL)
    eventually(lambda: killed not in servers.pids)
    assert httpx.get(f"{servers.address}/ready", timeout=60).json()["status"] == "ready"
    eventually(lambda: len(servers.pids) == 2 and killed not in servers.pids)
    assert other in servers.pids
    assert "No result is on the leaderboards yet" in httpx.get(servers.address, timeout=60).text
    assert_only_the_starter_looks_for_lost_work(servers)


def assert_only_the_starter_looks_for_lost_work(servers: Servers) -> None:
    def is_queued_again(shard_id: int) -> bool:
        with servers.database.transaction() as session:
            return bool(state_of(session, shard_id) is WorkState.QUEUED)

    with servers.database.transaction() as session:
        lost = shard_ids(session, submit(session, make_principal(session, "Losers")))[0]
    claim(servers.database, lost, lease_s=0.1)
    with ExitStack() as stack:
        for pid in servers.pids:
            os.kill(pid, signal.SIGSTOP)
            stack.callback(os.kill, pid, signal.SIGCONT)
        eventually(lambda: is_queued_again(lost))


def test_a_page_session_of_one_process_holds_at_the_other(servers: Servers) -> None:
    with servers.database.transaction() as session:
        secret = make_secret(session, make_principal(session, "Visitors"))
    one, other = servers.pids
    with servers.only(one):
        headers = {"sec-fetch-site": "same-origin"}
        signed_in = httpx.post(f"{servers.address}/sign-in", data={"token": secret}, headers=headers, timeout=60)
    assert signed_in.status_code == 303
    with servers.only(other), httpx.Client(cookies=signed_in.cookies, timeout=60) as browser:
        assert "Visitors" in browser.get(f"{servers.address}/submissions").text
