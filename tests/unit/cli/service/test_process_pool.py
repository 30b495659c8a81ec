import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from vitac.cli.service import process_pool
from vitac.cli.service.process_pool import ProcessPool
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
    monkeypatch.setattr(process_pool, "RESTART_PAUSE_S", 3600.0)
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
    monkeypatch.setattr(process_pool, "STOP_LIMIT_S", 0.2)
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
        "from vitac.cli.service.process_pool import ProcessPool\n"
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
