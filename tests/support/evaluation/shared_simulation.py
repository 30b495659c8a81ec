"""One loaded simulation for many evaluations, in tests that are not about how it is loaded.

Each evaluation by itself spends a second on that; a worker, too, keeps it from one to the next.
"""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import pytest
from vitac.evaluator.evaluation import local
from vitac.evaluator.shards import host_process
from vitac.evaluator.shards.process import ShardProcesses


class SharedProcesses(ShardProcesses):
    """Processes of shards for one evaluation after another."""

    def __exit__(self, *exception: object) -> None:
        """End all that has loaded a policy; the simulation stays loaded until `end`."""
        self._close_idle(list(self._idle))

    def end(self) -> None:
        """End everything."""
        super().__exit__()


@contextmanager
def loaded_once() -> Iterator[SharedProcesses]:
    """Processes that are there for the block."""
    processes = SharedProcesses()
    try:
        yield processes
    finally:
        processes.end()


def evaluate_with(processes: SharedProcesses, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have `evaluate` take its processes of shards from there."""
    monkeypatch.setattr(local, "ShardProcesses", lambda _: processes)
    monkeypatch.setattr(host_process, "HostProcess", lambda **_: nullcontext())
