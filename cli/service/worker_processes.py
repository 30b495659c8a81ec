"""Worker processes that belong to this one: started, started again when they die, ended.

Called by `serve` and `demo`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

COMMAND = ("-c", "import sys; from vitac.cli.main import main; main(['worker', '--end-with', sys.argv[1]])")
STOP_LIMIT_S = 15.0
RESTART_PAUSE_S = 2.0  # a worker that dies at once shall not keep the machine busy with starting it


@dataclass(kw_only=True)
class WorkerProcesses:
    """Some worker processes.

    Attributes:
        count: how many shall run.
        log: where they write.
        environment: added to this process's environment.
        say: told in a sentence when one has died.
        command: arguments of the Python interpreter that make a worker; our process id follows.
    """

    count: int
    log: IO[bytes] | int
    environment: dict[str, str] = field(default_factory=dict)
    say: Callable[[str], None]
    command: Sequence[str] = COMMAND
    _running: list[subprocess.Popen[bytes]] = field(default_factory=list, init=False)
    _not_before: float = field(default=0.0, init=False)

    @property
    def pids(self) -> list[int]:
        """Process ids of those that run."""
        return [process.pid for process in self._running]

    def start(self) -> None:
        """Start them all. Must be called in a thread that lives as long as they shall."""
        for _ in range(self.count):
            self._running.append(self._launch())

    def look_after(self) -> None:
        """Start another one for each that has died; called often."""
        for process in [process for process in self._running if process.poll() is not None]:
            if time.monotonic() < self._not_before:
                return
            self._running.remove(process)
            self.say(f"worker {process.pid} ended with code {process.returncode}; starting another one")
            self._running.append(self._launch())
            self._not_before = time.monotonic() + RESTART_PAUSE_S

    def stop(self) -> None:
        """Ask all to end, and kill those that do not within the limit."""
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
        # A session of its own: Ctrl-C reaches only this process, which then ends the workers in order.
        return subprocess.Popen(  # noqa: S603 - our own interpreter and arguments
            [sys.executable, *self.command, str(os.getpid())],
            stdin=subprocess.DEVNULL,
            stdout=self.log,
            stderr=self.log,
            env=os.environ | self.environment,
            start_new_session=True,
        )
