"""Lets processes that take turns with this one run on the core that it runs on; used by `session`."""

import ctypes
import os
from contextlib import suppress
from typing import Final

_LIBRARY: Final = ctypes.CDLL(None)


def _current_core() -> int:
    """Return the core that this process runs on; -1 where the system does not say."""
    return int(_LIBRARY.sched_getcpu()) if hasattr(_LIBRARY, "sched_getcpu") else -1


class SharedCore:
    """The core of this process, for others of which one runs at a time while this one waits for it.

    Where every core has work, the kernel wakes such a process behind the work of another core and leaves the one that
    waits for it idle: 6 ms for each episode of two evaluations on two cores. The processes may still choose other
    cores for themselves.
    """

    def __init__(self) -> None:
        self._members: set[int] = set()
        self._core = -1

    def add(self, pid: int) -> None:
        """Let a process run here from now on; where this one may not decide that, it runs where it likes."""
        self._members.add(pid)
        self._core = _current_core()
        self._place(pid)

    def remove(self, pid: int) -> None:
        """Leave a process alone from now on."""
        self._members.discard(pid)

    def follow(self) -> None:
        """Bring all here if this process runs on another core than before."""
        if _current_core() == self._core:
            return
        self._core = _current_core()
        for pid in self._members:
            self._place(pid)

    def _place(self, pid: int) -> None:
        if self._core < 0:  # this kernel does not say where a process runs
            return
        with suppress(OSError):  # it has ended, or this process has no right over it
            os.sched_setaffinity(pid, {self._core})
