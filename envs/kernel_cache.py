"""Where compiled kernels are stored on this machine, who compiles, and its progress; nothing here needs a compiler."""

import fcntl
import logging
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Self

from vitac.errors import VitacError

_LOG = logging.getLogger("vitac.envs.compilation")
_NAME = "kernels"
# A folder that no process has read or written for this time [s] is removed.
_UNUSED_S = 30 * 86400.0
# A folder's time of use is written at most so often [s].
_USE_NOTED_S = 86400.0


class CacheNotWritable(VitacError):
    """Compiled kernels cannot be stored in the folder for them; the message names it. Set `VITAC_CACHE_DIR`."""


@cache
def cache_directory() -> Path:
    """Return the folder of compiled kernels: the one that processes share, else a private temporary one.

    A shared folder that `vitac compile` has filled is only read where it cannot be written to.
    """
    if shared := shared_directory() or _read_only_directory():
        return shared
    _LOG.warning(
        "Compiled kernels cannot be stored in %s: every process compiles for itself, for half a minute. Name a folder "
        "that can be written to in VITAC_CACHE_DIR, or fill it once with `vitac compile`.",
        cache_root(),
    )
    return _private_directory()


def shared_directory() -> Path | None:
    """Return the folder in `VITAC_CACHE_DIR` or the user's cache folder; None where it cannot be written to."""
    directory = cache_root() / _NAME
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return directory if os.access(directory, os.W_OK) else None


def note_use(folder: Path) -> None:
    """Set the time of use of a module's folder, where it is long ago and the folder is ours."""
    with suppress(OSError):  # another process has removed it, or another user owns it
        if time.time() - folder.stat().st_mtime > _USE_NOTED_S:
            os.utime(folder)


def remove_unused(directory: Path) -> None:
    """Remove what has not been used for 30 days: modules' folders, and caches of earlier versions beside them."""
    folders = [path for path in directory.iterdir() if path.is_dir()]
    folders += [path for path in directory.parent.glob(f"{_NAME}-*") if path.is_dir()]
    for folder in folders:
        try:
            unused = time.time() - folder.stat().st_mtime > _UNUSED_S
        except FileNotFoundError:  # another process has removed it
            continue
        if unused:
            shutil.rmtree(folder, ignore_errors=True)


def cache_root() -> Path:
    """Return the folder of all that is stored between runs: `VITAC_CACHE_DIR`, else in the user's cache folder."""
    if explicit := os.environ.get("VITAC_CACHE_DIR"):
        return Path(explicit)
    home_cache = os.environ.get("XDG_CACHE_HOME")
    return (Path(home_cache) if home_cache else Path.home() / ".cache") / "vitac"


def _read_only_directory() -> Path | None:
    """Return the shared folder if it holds compiled kernels."""
    directory = cache_root() / _NAME
    return directory if next(directory.glob("*/*.nbi"), None) else None


def _private_directory() -> Path:
    directory = Path(tempfile.mkdtemp(prefix="vitac-")) / _NAME
    directory.mkdir()
    return directory


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
                match = _TEXT.fullmatch(os.pread(lock, 100, 0).decode("ascii", "replace"))
                if match and _is_own(int(match[3])) and _is_held(lock):
                    return cls(compiled=int(match[1]), kernels=int(match[2]))
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


# How often a waiting process looks, and after how long it says that it waits.
_POLL_S = 0.1
_SILENT_S = 1.0
_LONGEST_S = 900.0


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
        except BlockingIOError as error:
            waited_s = time.monotonic() - started
            if waited_s > _LONGEST_S:
                raise TimeoutError(f"another process has held it for {waited_s / 60:.0f} minutes; end that") from error
            if waited_s > _SILENT_S:
                _say_waiting(folder)
            time.sleep(_POLL_S)
        else:
            return


@cache
def _say_waiting(folder: Path) -> None:
    """Say it once in a process, not for every kernel."""
    _LOG.warning(
        "Another process is compiling the physics into %s; waiting for it, at most %.0f minutes.",
        folder,
        _LONGEST_S / 60,
    )
