"""One process of a machine compiles at a time; the others wait until its machine code can be loaded."""

import fcntl
import logging
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path

from .progress import LOCK_FILE, CompileProgress

_LOG = logging.getLogger("vitac.envs.compilation")
# How often a waiting process looks, and after how long it says that it waits.
_POLL_S = 0.1
_SILENT_S = 1.0


class CompilingTurn:
    """The turn to compile, held by at most one process for each cache folder.

    A kernel compiles those that it calls, so a process that has the turn takes it again at once. The operating system
    ends the turn of a process that dies. Threads are kept apart by Numba's own lock, which callers hold.
    """

    def __init__(self) -> None:
        self._lock: int | None = None
        self._has_warned = False

    @contextmanager
    def taken(self, folder: Path, progress: CompileProgress) -> Iterator[None]:
        """Wait for the turn, and hold it for the body; whoever started this process can read how far it is.

        Where the folder takes no lock file, or its file system has no locks, say so once and run the body without.
        """
        if self._lock is not None or (lock := self._locked(folder)) is None:
            yield
            return
        self._lock = lock
        try:
            self.tell(progress)
            yield
        finally:
            self._lock = None
            with suppress(OSError):  # nothing reads the text of a lock that nobody holds
                os.ftruncate(lock, 0)
            os.close(lock)

    def _locked(self, folder: Path) -> int | None:
        """Return the lock file once this process holds its lock; None where there can be none."""
        try:
            with ExitStack() as opened:
                lock = os.open(folder / LOCK_FILE, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
                opened.callback(os.close, lock)
                _wait_for(lock, folder)
                opened.pop_all()
                return lock
        except OSError as error:
            if not self._has_warned:
                _LOG.warning(
                    "Expected a folder that takes a lock file, got %s (%s); compiling without it, which other "
                    "processes may do at the same time.",
                    folder,
                    error,
                )
                self._has_warned = True
            return None

    def tell(self, progress: CompileProgress) -> None:
        """Write how far compiling is; nothing where this process has no turn or the disk is full."""
        if self._lock is not None:
            with suppress(OSError):
                os.pwrite(self._lock, progress.as_bytes(), 0)


def _wait_for(lock: int, folder: Path) -> None:
    started = time.monotonic()
    while True:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() - started > _SILENT_S:
                _say_waiting(folder)
            time.sleep(_POLL_S)
        else:
            return


@cache
def _say_waiting(folder: Path) -> None:
    """Say it once in a process, not for every kernel."""
    _LOG.warning("Another process is compiling the physics into %s; waiting for it.", folder)
