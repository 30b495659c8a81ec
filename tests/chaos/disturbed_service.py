"""A whole service as an operator runs it, `vitac serve` and workers, each started again when it ends."""

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psycopg
from vitac.server.database.cluster import Cluster

VITAC = "import sys; from vitac.cli.main import main; main(sys.argv[1:])"
TRACKS = Path(__file__).with_name("tracks")
RESTART_PAUSE_S = 0.5
STOP_LIMIT_S = 300.0


@dataclass(kw_only=True)
class DisturbedService:
    """The service in a folder. A supervisor starts what has ended, from `start` to `stop`."""

    folder: Path
    workers: int
    port: int = field(default_factory=lambda: free_port())
    tracks: Path = TRACKS
    agents: dict[str, Path] = field(default_factory=dict)
    """The file of each station whose agent runs, by the agent's name; its key lies beside it."""
    ended: set[int] = field(default_factory=set)
    """Process ids of workers that were asked to end: a second request would end them at once, with all they left."""
    _running: dict[str, "subprocess.Popen[bytes]"] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _stopping: threading.Event = field(default_factory=threading.Event)
    _supervisor: threading.Thread | None = None

    @property
    def state_dir(self) -> Path:
        return self.folder / "state"

    @property
    def temporary_dir(self) -> Path:
        return self.folder / "tmp"

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def environment(self) -> dict[str, str]:
        return os.environ | {
            "TMPDIR": str(self.temporary_dir),
            "VITAC_STATE_DIR": str(self.state_dir),
            "VITAC_TRACKS_DIR": str(self.tracks),
            "VITAC_PORT": str(self.port),
            "VITAC_SERVER_PROCESSES": "2",
            "VITAC_REGISTRATIONS_PER_HOUR": "100000",
            "VITAC_UPLOADS_AT_ONCE": "10",
            "VITAC_CLIENT_SHARE": "1",
            "VITAC_QUOTAS": '{"attempts_per_day": null, "queued_at_once": null, "stored_mib": null}',
        }

    def start(self) -> None:
        """Start everything and keep it running."""
        self.temporary_dir.mkdir(mode=0o711)
        self._supervisor = threading.Thread(target=self._supervise, name="supervisor", daemon=True)
        self._supervisor.start()

    def stop(self) -> None:
        """End everything in order: workers first, then the server."""
        self._stopping.set()
        assert self._supervisor is not None
        self._supervisor.join()
        for name in sorted(self._running, reverse=True):  # workers before the server
            self._running[name].terminate()
            self._running[name].wait(STOP_LIMIT_S)

    def pid(self, name: str) -> int | None:
        """Process id of `server`, `worker 1`, ...; None while it is not there."""
        with self._lock:
            process = self._running.get(name)
            return process.pid if process is not None and process.poll() is None else None

    @property
    def worker_names(self) -> list[str]:
        return [f"worker {number}" for number in range(1, self.workers + 1)]

    def pids(self) -> list[int]:
        """All processes of the service, also those whose parent has gone.

        They have the folder in their environment; those in a sandbox, which have none, its submission in their mounts.
        """
        name = os.fsencode(self.folder.name)
        marks = {"environ": name, "cmdline": name, "mountinfo": b"/Chaos "}
        return [
            pid
            for pid in processes()
            if pid != os.getpid() and any(mark in content_of(pid, file) for file, mark in marks.items())
        ]

    def web_pids(self) -> list[int]:
        """The processes that answer requests."""
        server = self.pid("server")
        return [pid for pid in descendants(server) if b"web_process" in command_of(pid)] if server else []

    def database_pids(self) -> list[int]:
        """The processes of PostgreSQL, the first one of them first."""
        found = [pid for pid in processes() if working_dir_of(pid) == self.state_dir / "postgres/cluster/data"]
        try:
            first = int((self.state_dir / "postgres/cluster/data/postmaster.pid").read_text().split("\n")[0])
        except (OSError, ValueError):
            return found
        return sorted(found, key=lambda pid: pid != first)

    def query(self, statement: str, *values: Any, database: str = "vitac") -> list[tuple[Any, ...]]:
        """Ask the database directly, as the owner of its tables.

        Raises:
            OSError, psycopg.Error: it does not answer.
        """
        with psycopg.connect(Cluster(self.state_dir).dsn(database), autocommit=True, connect_timeout=5) as connection:
            cursor = connection.execute(statement, values)
            return cursor.fetchall() if cursor.description else []

    def _supervise(self) -> None:
        while not self._stopping.is_set():
            for name in ("server", *self.worker_names, *list(self.agents)):
                if self.pid(name) is None:
                    self._launch(name)
            self._stopping.wait(RESTART_PAUSE_S)

    def _words(self, name: str) -> list[str]:
        """The command of a process, after `vitac`."""
        if name in self.agents:
            file = self.agents[name]
            return ["station", "run", str(file), "--key", str(file.with_suffix(".key"))]
        return ["serve" if name == "server" else "worker"]

    def _launch(self, name: str) -> None:
        with (self.folder / f"{name}.log").open("ab") as log:
            process = subprocess.Popen(
                [sys.executable, "-c", VITAC, *self._words(name)],
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        with self._lock:
            self._running[name] = process


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def processes() -> Iterator[int]:
    return (int(path.name) for path in Path("/proc").glob("[0-9]*"))


def descendants(pid: int) -> list[int]:
    """All processes below one, nearest first."""
    found: list[int] = []
    for parent in (generation := [pid]):
        try:
            for task in Path(f"/proc/{parent}/task").iterdir():
                children = [int(child) for child in (task / "children").read_text().split()]
                generation.extend(children)
                found.extend(children)
        except OSError:
            continue
    return found


def command_of(pid: int) -> bytes:
    return content_of(pid, "cmdline")


def is_of_policy(pid: int) -> bool:
    """Return whether a process runs a team's code: it is in a sandbox and not the first one there."""
    found = re.search(rb"^NSpid:\t\d+\t.*?(\d+)$", content_of(pid, "status"), re.MULTILINE)
    return found is not None and int(found[1]) != 1


def content_of(pid: int, file: str) -> bytes:
    """A file of a process in /proc; empty when it has ended."""
    try:
        return Path(f"/proc/{pid}/{file}").read_bytes()
    except OSError:
        return b""


def working_dir_of(pid: int) -> Path | None:
    try:
        return Path(f"/proc/{pid}/cwd").readlink()
    except OSError:
        return None


def send(number: signal.Signals, *pids: int) -> None:
    """Send a signal to those that are still there."""
    for pid in pids:
        try:
            os.kill(pid, number)
        except ProcessLookupError:
            continue


def pause_processes(pids: list[int], seconds: float) -> None:
    """Stop processes for a while, as a machine does that sleeps or swaps."""
    send(signal.SIGSTOP, *pids)
    time.sleep(seconds)
    send(signal.SIGCONT, *pids)
