"""What goes wrong in a chaos run. Each fault disturbs the service once and says what it did."""

import math
import random
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import psycopg
from disturbed_service import DisturbedService, command_of, descendants, is_of_policy, pause_processes, send
from small_disk import fill, make_room

OTHER_READY = """
    SELECT count(*) FROM workers WHERE state = 'ready' AND pid <> %s AND heartbeat_at > now() - interval '4 seconds'
"""
LOOK_S = 0.1
FULL_DISK_S = 5.0
DISCONNECT = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = 'vitac'"
RUNNING_ON = """
    SELECT work.id, work.token FROM work JOIN workers ON workers.id = work.worker_id
    WHERE work.state = 'running' AND workers.pid = %s
"""


@dataclass(kw_only=True)
class Faults:
    """The faults of one run, drawn by its seed.

    Attributes:
        service: what is disturbed.
        random: decides.
        has_small_disk: whether the state directory is on a disk that may be filled.
        cut_s: how long connections to the database are refused [s].
        lost_shard_limit_s: how long the shard of a killed worker is waited for [s].
        lost_shard_s: how long the shards of killed workers took to run elsewhere [s]; infinite where they never did.
    """

    service: DisturbedService
    random: random.Random
    has_small_disk: bool
    cut_s: float
    lost_shard_limit_s: float
    lost_shard_s: list[float] = field(default_factory=list)

    def all(self) -> list[Callable[[], str]]:
        """One of each, in a random order."""
        found = [
            *(self.kill_worker, self.kill_worker, self.kill_shard, self.kill_server, self.kill_web_process),
            *(self.kill_database, self.kill_backend, self.kill_everything, self.end_worker, self.end_server),
            *(self.pause_worker, self.pause_web_process, self.pause_database, self.cut_connections),
        ]
        if self.has_small_disk:
            found.append(self.fill_disk)
        self.random.shuffle(found)
        return found

    def kill_worker(self) -> str:
        """Kill a worker that runs a shard if there is one; if another is ready, wait until that shard runs there."""
        for name in self.random.sample(self.service.worker_names, self.service.workers):
            pid = self.service.pid(name)
            held = self._ask(RUNNING_ON, pid)
            if pid is not None and held:
                break
        if pid is None:
            return "no worker to kill"
        is_other_ready = self._ask(OTHER_READY, pid) not in ([], [(0,)])
        send(signal.SIGKILL, pid)
        if not is_other_ready:
            return f"killed {name} while no other was ready"
        return f"killed {name}{self._wait_for_other_worker(held)}"

    def kill_shard(self) -> str:
        """Kill a process below a worker: the one that forks shards, a shard, or one of its sandbox.

        Not one of the policy: a policy may kill itself, and nobody can tell who did it.
        """
        name = self.random.choice(self.service.worker_names)
        below = [pid for pid in descendants(self.service.pid(name) or 0) if not is_of_policy(pid)]
        if not below:
            return f"nothing runs below {name}"
        pid = self.random.choice(below)
        said = command_of(pid).replace(b"\0", b" ").decode(errors="replace")[:60]
        send(signal.SIGKILL, pid)
        return f"killed a process of {name}: {said}"

    def kill_server(self) -> str:
        send(signal.SIGKILL, *self._pids_of("server"))
        return "killed the server"

    def kill_web_process(self) -> str:
        pids = self.service.web_pids()
        send(signal.SIGKILL, *pids[:1])
        return f"killed {len(pids[:1])} web process"

    def kill_database(self) -> str:
        pids = self.service.database_pids()
        send(signal.SIGKILL, *pids[:1])
        return "killed PostgreSQL's first process"

    def kill_backend(self) -> str:
        pids = self.service.database_pids()[1:]
        if pids:
            send(signal.SIGKILL, self.random.choice(pids))
        return f"killed one of {len(pids)} backends"

    def kill_everything(self) -> str:
        pids = [pid for name in ("server", *self.service.worker_names) for pid in self._pids_of(name)]
        below = [child for pid in pids for child in descendants(pid)]
        send(signal.SIGKILL, *pids, *below, *self.service.database_pids())
        return f"killed all {len(pids) + len(below)} processes"

    def end_worker(self) -> str:
        name = self.random.choice(self.service.worker_names)
        pids = self._pids_of(name)
        self.service.ended.update(pids)
        send(signal.SIGTERM, *pids)
        return f"ended {name}"

    def end_server(self) -> str:
        send(signal.SIGTERM, *self._pids_of("server"))
        return "ended the server"

    def pause_worker(self) -> str:
        """Stop a worker until its lease has run out; it wakes up and must not write."""
        name = self.random.choice(self.service.worker_names)
        pid = self.service.pid(name)
        pause_processes([pid, *descendants(pid)] if pid else [], 9.0)
        return f"stopped {name} for 9 s"

    def pause_web_process(self) -> str:
        pause_processes(self.service.web_pids()[:1], 3.0)
        return "stopped a web process for 3 s"

    def pause_database(self) -> str:
        pause_processes(self.service.database_pids(), 3.0)
        return "stopped PostgreSQL for 3 s"

    def cut_connections(self) -> str:
        """End all connections to the database and refuse new ones for a while."""
        try:
            self.service.query("ALTER DATABASE vitac ALLOW_CONNECTIONS false", database="postgres")
            self.service.query(DISCONNECT, database="postgres")
        except (OSError, psycopg.Error) as error:
            return f"could not cut the connections: {type(error).__name__}"
        time.sleep(self.cut_s)
        while True:
            try:
                self.service.query("ALTER DATABASE vitac ALLOW_CONNECTIONS true", database="postgres")
            except (OSError, psycopg.Error):
                time.sleep(LOOK_S)
                continue
            return f"cut all connections to the database for {self.cut_s:g} s"

    def fill_disk(self) -> str:
        try:
            fill(self.service.state_dir)
            time.sleep(FULL_DISK_S)
        finally:
            make_room(self.service.state_dir)
        return f"filled the disk for {FULL_DISK_S:g} s"

    def _pids_of(self, name: str) -> list[int]:
        pid = self.service.pid(name)
        return [pid] if pid is not None else []

    def _ask(self, statement: str, pid: int | None) -> list[tuple[Any, ...]]:
        """Return what the database says of a worker's process, nothing while it does not answer."""
        try:
            return self.service.query(statement, pid) if pid is not None else []
        except (OSError, psycopg.Error):
            return []

    def _wait_for_other_worker(self, held: list[tuple[Any, ...]]) -> str:
        """Return how long it took until another worker ran the shards of a killed one."""
        began = time.monotonic()
        for shard, token in held:
            while not self._runs_elsewhere(shard, token):
                if time.monotonic() - began > self.lost_shard_limit_s:
                    self.lost_shard_s.append(math.inf)
                    return f"; shard {shard} did not run elsewhere within {self.lost_shard_limit_s:g} s"
                time.sleep(LOOK_S)
            self.lost_shard_s.append(time.monotonic() - began)
        if not held:
            return ", which ran nothing"
        return f"; its shard ran elsewhere after {self.lost_shard_s[-1]:.1f} s"

    def _runs_elsewhere(self, shard: int, token: int) -> bool:
        try:
            rows = self.service.query("SELECT state, token FROM work WHERE id = %s", shard)
        except (OSError, psycopg.Error):
            return False
        state, now = rows[0]
        return state in ("done", "failed", "cancelled") or now > token  # each claim raises it
