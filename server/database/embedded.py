"""Keeps the embedded PostgreSQL running; every process of the service without VITAC_DATABASE_URL has one of these.

The process that holds the file lock runs the server and starts it again whenever it dies; the others use the address
file. Of these, servers and commands of `vitac admin` take over when the owner is gone; workers never do, so that
killing any of them leaves the database alone. The server ends with its owner, also after a `kill -9` of the owner.
"""

import fcntl
import subprocess
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import psycopg
import structlog
from psycopg.conninfo import make_conninfo
from psycopg.pq import PGconn, Ping
from vitac.errors import VitacError

from .availability import DatabaseUnreachable
from .binaries import NOTICE_EVERY_S
from .cluster import Cluster, DatabaseStartFailed
from .engine import has_no_free_connection

logger = structlog.get_logger(__name__)

OWNER_POLL_S = 0.2  # how often a process that does not own the database tries to take it over
RESTART_PAUSE_S = (0.0, 0.1, 0.5, 2.0)  # before the next start of a server that keeps dying at once
HEALTHY_AFTER_S = 30.0
FIRST_NOTICE_S = 2.0  # an ordinary start is quicker
ANSWER_S = 2  # within which a server that is there takes a connection
NO_ANSWER_S = 30.0  # a server of another process that says nothing for so long hangs


class EmbeddedPostgres:
    """A PostgreSQL that runs from `start` to `stop`, in this process or another one.

    Used as a context manager, or with `start` and `stop`.
    """

    def __init__(
        self,
        state_dir: Path,
        *,
        bin_dir: Path | None = None,
        options: Sequence[str] = (),
        may_run: bool = True,
        wait_s: float | None = None,
    ) -> None:
        """Prepare; nothing is started.

        Args:
            state_dir: folder whose `postgres` holds it.
            bin_dir: folder with PostgreSQL's programs; found by itself if None.
            options: `name=value` server settings.
            may_run: whether this process runs the server when nobody else does, or only waits for another one.
            wait_s: how long it waits for another one that does not run [s]; None: without limit.
        """
        self.cluster = Cluster(state_dir, bin_dir=bin_dir, options=options)
        self._may_run = may_run
        self._wait_s = wait_s
        self._stopping = threading.Event()
        self._keeper: threading.Thread | None = None
        self._failure: VitacError | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._owns = False

    @property
    def server_pid(self) -> int | None:
        """Process id of the server when this process runs it."""
        return self._process.pid if self._process is not None else None

    def start(self) -> str:
        """Make the database available and return its address; wait for as long as it recovers or another starts it.

        Raises:
            DatabaseUnreachable: nobody else runs it.
            VitacError: it cannot be started here, or that of another process hangs; the message says why.
        """
        if self._may_run:
            self.cluster.make_folder()
            # A thread of its own, alive until `stop`: the server's death signal is tied to the thread that started it.
            self._keeper = threading.Thread(target=self._keep, name="embedded-postgres", daemon=True)
            self._keeper.start()
        began = heard = time.monotonic()
        noticed = heard - NOTICE_EVERY_S + FIRST_NOTICE_S
        while (address := self._address()) is None:
            if self._failure is not None:
                self.stop()
                raise self._failure
            if self._owns or not self._may_run or not self._hangs():
                heard = time.monotonic()
            elif time.monotonic() - heard > NO_ANSWER_S:
                self.stop()
                raise DatabaseStartFailed(
                    f"The database in {self.cluster.folder} is run by another process and has not answered for "
                    f"{NO_ANSWER_S:.0f} s. Look at that process and at its disk."
                )
            if not self._may_run and self._wait_s is not None and time.monotonic() - began > self._wait_s:
                raise DatabaseUnreachable(
                    f"Nobody has started the database in {self.cluster.folder} for {self._wait_s:.0f} s; `vitac serve` "
                    "does, and VITAC_DATABASE_URL names another one."
                )
            if time.monotonic() - noticed > NOTICE_EVERY_S:
                noticed = time.monotonic()
                logger.warning("database_awaited", started_by="this process" if self._may_run else "`vitac serve`")
            time.sleep(0.05)
        return address

    def stop(self) -> None:
        """End the server if this process runs it, otherwise only stops waiting for the ownership."""
        self._stopping.set()
        if self._keeper is not None:
            self._keeper.join()

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def _address(self) -> str | None:
        """Return the address if somebody answers there, also that no connection is free."""
        try:
            address = self.cluster.dsn_file.read_text()
        except FileNotFoundError:
            return None
        try:
            psycopg.connect(address, connect_timeout=ANSWER_S).close()
        except psycopg.OperationalError as error:
            return address if has_no_free_connection(error) else None
        return address

    def _hangs(self) -> bool:
        """Return whether there should be a server that neither takes connections nor says that it starts."""
        try:
            address = make_conninfo(self.cluster.dsn_file.read_text(), connect_timeout=ANSWER_S)
            return PGconn.ping(address.encode()) != Ping.REJECT
        except FileNotFoundError:
            return False

    def _keep(self) -> None:
        with self.cluster.lock_file.open("a") as lock:
            self.cluster.lock_file.chmod(0o600)
            while not self._stopping.is_set():
                if not _try_lock(lock.fileno()):
                    self._stopping.wait(OWNER_POLL_S)
                    continue
                self._owns = True
                self._own()
                self._owns = False
                fcntl.flock(lock, fcntl.LOCK_UN)

    def _own(self) -> None:
        """Run the server until `stop`, starting it again when it dies."""
        deaths = 0
        while not self._stopping.is_set():
            started = time.monotonic()
            try:
                self._serve_once()
            except (VitacError, OSError, psycopg.Error) as error:
                logger.error("database_start_failed", error=str(error))
                self._failure = error if isinstance(error, VitacError) else DatabaseStartFailed(str(error))
            deaths = 1 if time.monotonic() - started > HEALTHY_AFTER_S else deaths + 1
            self._stopping.wait(RESTART_PAUSE_S[min(deaths - 1, len(RESTART_PAUSE_S) - 1)])

    def _serve_once(self) -> None:
        self.cluster.initialise()
        self._process = self.cluster.start()
        try:
            if not self.cluster.wait_until_ready(self._process, self._stopping):
                return
            self.cluster.make_database()
            self._failure = None
            while not self._stopping.is_set() and self._process.poll() is None:
                self._stopping.wait(0.05)
            if not self._stopping.is_set():
                logger.warning("database_died", pid=self._process.pid, code=self._process.returncode)
        finally:
            self.cluster.stop(self._process)
            self._process = None


def _try_lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
