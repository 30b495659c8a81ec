"""A pool of processes, workers or servers: started, restarted when they end, stopped with this process.

Called by `process_tree`.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import IO

COMMAND = ("-c", "import sys; from vitac.cli.main import main; main(['worker', '--end-with', sys.argv[1]])")
STOP_LIMIT_S = 15.0
RESTART_PAUSE_S = 2.0  # limits how often a worker that ends at once is restarted


@dataclass(kw_only=True)
class ProcessPool:
    """Several processes of one kind.

    Attributes:
        noun: what one of them is called.
        count: number of processes.
        log: file that they write their service events to.
        environment: added to this process's environment.
        notify: called with a sentence when one has ended.
        command: arguments of the Python interpreter that start one; our process id is appended.
        inherited: file descriptors that they keep.
    """

    noun: str = "worker"
    count: int
    log: IO[bytes] | int
    environment: dict[str, str] = field(default_factory=dict)
    notify: Callable[[str], None]
    command: Sequence[str] = COMMAND
    inherited: Sequence[int] = ()
    _running: list[subprocess.Popen[bytes]] = field(default_factory=list, init=False)
    _not_before: float = field(default=0.0, init=False)

    @property
    def pids(self) -> list[int]:
        """Ids of the running processes."""
        return [process.pid for process in self._running]

    def start(self) -> None:
        """Start all. Call this in a thread that lives as long as they should: they end with it."""
        for _ in range(self.count):
            self._running.append(self._launch())

    def restart_ended(self) -> None:
        """Start a new process for each that has ended; call this regularly."""
        for process in [process for process in self._running if process.poll() is not None]:
            if time.monotonic() < self._not_before:
                return
            self._running.remove(process)
            self.notify(f"{self.noun} {process.pid} ended with code {process.returncode}; starting another one")
            self._running.append(self._launch())
            self._not_before = time.monotonic() + RESTART_PAUSE_S

    def stop(self) -> None:
        """Send all SIGTERM, and kill those that have not ended within the limit."""
        for process in self._running:
            process.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + STOP_LIMIT_S
        for process in self._running:
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._running.clear()

    def _launch(self) -> subprocess.Popen[bytes]:
        # A session of its own: Ctrl-C reaches only this process, which then stops the workers in order.
        return subprocess.Popen(  # noqa: S603 - our own interpreter and arguments
            [sys.executable, *self.command, str(os.getpid())],
            stdin=subprocess.DEVNULL,
            stdout=self.log,
            stderr=self.log,
            env=os.environ | self.environment,
            pass_fds=self.inherited,
            start_new_session=True,
        )
