"""How far the process is that compiles kernels on this machine: it writes, whoever started it reads."""

import fcntl
import os
import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Self

LOCK_FILE = "compiling.lock"
STARTED_LOG = "vitac.envs.compilation.started"
"""Logger of the line that a process writes when it begins to compile, for commands that show progress themselves."""
# All texts are equally long, so that each covers the one before it.
_TEXT = re.compile(r" *(\d+) of +(\d+) kernels in process +(\d+)\n")


@dataclass(frozen=True, kw_only=True)
class CompileProgress:
    """How far compiling is.

    Attributes:
        compiled: kernels that the process has compiled.
        kernels: all that it may have to compile; fewer if some are in the cache already.
    """

    compiled: int
    kernels: int

    def as_bytes(self) -> bytes:
        """Return the contents of the lock file."""
        return f"{self.compiled:6} of {self.kernels:6} kernels in process {os.getpid():10}\n".encode()

    @classmethod
    def read_own_processes(cls, folder: Path) -> Self | None:
        """Return how far this process, or one that it has started, is with compiling into a folder.

        None where none of them compiles, or nothing can be read. A process that was killed leaves its text behind, but
        not its lock.
        """
        with suppress(OSError):
            lock = os.open(folder / LOCK_FILE, os.O_RDONLY | os.O_CLOEXEC)
            try:
                found = _TEXT.fullmatch(os.pread(lock, 100, 0).decode("ascii", "replace"))
                if found and _is_own(int(found[3])) and _is_held(lock):
                    return cls(compiled=int(found[1]), kernels=int(found[2]))
            finally:
                os.close(lock)
        return None


def _is_own(process: int) -> bool:
    """Return whether a process is this one or was started by it, directly or through others."""
    while process > 1 and process != os.getpid():
        # "pid (name) state parent ...": the name may hold anything, also brackets.
        process = int(Path(f"/proc/{process}/stat").read_text(errors="replace").rpartition(")")[2].split()[1])
    return process == os.getpid()


def _is_held(lock: int) -> bool:
    """Return whether another descriptor holds the lock; where none does, it is left free."""
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    fcntl.flock(lock, fcntl.LOCK_UN)
    return False
