"""Stands in for the memory control group where there is none: looks at resident memory several times a second."""

import threading
from typing import Final, Self

from . import process_tree

_INTERVAL_S: Final = 0.1


class MemoryWatchdog:
    """Kills the processes of a sandbox that together hold more resident memory than allowed."""

    def __init__(self, first_pid: int, *, memory_bytes: int) -> None:
        self._first_pid = first_pid
        self._memory_bytes = memory_bytes
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="memory-watchdog", daemon=True)
        self.spared_pid = 0
        """The loaded copy, which holds nothing that the episode's process does not hold as well."""
        self.kills = 0

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        self._thread.join()

    def look(self) -> None:
        """Look once."""
        pids = [pid for pid in process_tree.descendants(self._first_pid) if pid != self.spared_pid]
        # The first sum counts shared pages for everyone who shares them, but is quick; the second is exact.
        for size_of in (process_tree.resident_bytes, process_tree.proportional_bytes):
            if sum(map(size_of, pids)) <= self._memory_bytes:
                return
        self.kills += 1
        process_tree.kill_descendants(self._first_pid, spared_pid=self.spared_pid)

    def _watch(self) -> None:
        while not self._stop.wait(_INTERVAL_S):
            self.look()
