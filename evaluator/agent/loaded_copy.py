"""The loaded policy, frozen: every episode runs in an identical copy of it, and what an episode leaves is found out.

The frozen process never runs again, so nothing in its memory can count episodes: no module variable, no hook on fork,
no thread. What processes share otherwise (open files, shared memory, temporary files, pids) is refused once after
loading, put back before each copy, or found to have changed, and then the sandbox is restarted.
"""

import math
import os
import resource
import shutil
import signal
import struct
import time
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

from .exchange import EpisodeProcess
from .isolation import process_tree, tracing
from .isolation.bubblewrap import DEVICES
from .isolation.process_tree import ProcessIds
from .isolation.tracing import NotWaiting, TracedProcess, TracedProcessGone
from .verdicts import PolicyFailed, VerdictCode

_CLONE_PARENT: Final = 0x00008000
_CLONE_CHILD_CLEARTID: Final = 0x00200000
_CLONE_CHILD_SETTID: Final = 0x01000000
_FLAGS: Final = signal.SIGCHLD | _CLONE_PARENT | _CLONE_CHILD_CLEARTID | _CLONE_CHILD_SETTID
_PR_SET_DUMPABLE: Final = 4
_PR_GET_TID_ADDRESS: Final = 40
_NO_SUCH_PROCESS: Final = -3
_CLEAR_DEADLINE_S: Final = 5.0
_WIPED_ENTRIES_MAX: Final = 5_000
_WIPED_DEPTH_MAX: Final = 16
_FOLDER_MODE: Final = 0o1777
_WRITEABLE_FOLDERS: Final = ("tmp", "dev/shm")


@dataclass(frozen=True, kw_only=True)
class OpenFile:
    """An open file as the kernel describes it; copies share its position and flags."""

    descriptor: int
    target: str
    position: int
    flags: int
    mode: int
    owner: tuple[int, int]
    locks: tuple[str, ...]
    """Locks that belong to the open file and not to a process."""


class LoadedCopy:
    """Keeps the loaded policy stopped and makes copies of it.

    Args:
        pid: process that reported to be loaded, as seen from outside.
        process_ids: the sandbox's counter.
        own_files: pipe and socket that we gave it, as /proc names them.
        episode_cpu_s: CPU time at which the kernel stops a copy [s].

    Raises:
        PolicyFailed: shared_state, protocol_violation.
        TracedProcessGone: it was killed meanwhile.
    """

    def __init__(self, pid: int, *, process_ids: ProcessIds, own_files: frozenset[str], episode_cpu_s: float) -> None:
        self.pid = pid
        self._own_files = own_files.union(DEVICES)
        self._process_ids = process_ids
        self.process_ids_repeat = False
        """True where every copy gets the same process id, so that it does not show how many there were before."""
        try:
            self._process = TracedProcess(pid)
        except NotWaiting as error:
            raise PolicyFailed(VerdictCode.PROTOCOL_VIOLATION, f"After loading, {error}.") from error
        try:
            self._prepare(episode_cpu_s)
        except BaseException:
            self.end()
            raise

    def _prepare(self, episode_cpu_s: float) -> None:
        self._process.call(tracing.SYS_PRCTL, _PR_SET_DUMPABLE, 1)  # else its files in /proc could be closed to us
        self._check_threads()
        self._end_all_others()
        self._wipe()
        self._files = self._checked_files()
        self._check_memory()
        self._folders = self._folder_states()
        self._signals = self._pending_signals()
        self._tid_address = self._find_tid_address()
        self._limit_cpu(math.ceil(episode_cpu_s))
        self._inside_pid = process_tree.inside_pid(self.pid)
        self.process_ids_repeat = self._process_ids.continue_after(self._inside_pid)

    def copy(self) -> EpisodeProcess:
        """Start the next episode's process; it waits for its first question.

        Raises:
            TracedProcessGone: the policy has killed its own loaded copy.
        """
        self._reset_times()
        outside_pid, inside_pid = self._process.fork(_FLAGS, self._tid_address)
        return EpisodeProcess(outside_pid=outside_pid, inside_pid=inside_pid)

    def kill_all_others(self) -> bool:
        """Kill every process of the episode without waiting for their ends; False if the loaded policy is gone."""
        try:
            self._process.call(tracing.SYS_KILL, -1, signal.SIGKILL)
        except TracedProcessGone:
            return False
        return True

    def clear(self) -> bool:
        """End every process of the episode; return whether all is as it was before it.

        False means that the policy has left something that only a new sandbox removes.
        """
        try:
            self._end_all_others()
            if self.process_ids_repeat and not self._process_ids.continue_after(self._inside_pid):
                return False
            if self._pending_signals() != self._signals:
                return False
            return self._restore_files() and self._folder_states() == self._folders
        except (TracedProcessGone, OSError):  # OSError: names longer than a path may be, links that cannot be read
            return False

    def end(self) -> None:
        """Kill the loaded policy."""
        self._process.end()

    def _end_all_others(self) -> None:
        """Kill every other process of the sandbox but the first in one system call, until there is none to kill."""
        deadline = time.monotonic() + _CLEAR_DEADLINE_S
        while self._process.call(tracing.SYS_KILL, -1, signal.SIGKILL) != _NO_SUCH_PROCESS:
            if time.monotonic() > deadline:
                raise TracedProcessGone
            time.sleep(0.0002)

    # Open files

    def _checked_files(self) -> list[OpenFile]:
        files = self._open_files()
        for file in files:
            if file.target not in self._own_files and not self._is_harmless(file):
                raise PolicyFailed(
                    VerdictCode.SHARED_STATE,
                    f"After loading, {_describe(file)} was still open; all episodes would share it. Close it before "
                    "the constructor returns and open it again where it is needed.",
                )
        return files

    def _is_harmless(self, file: OpenFile) -> bool:
        """Return whether a file is only read and lies where nobody can write."""
        if file.flags & os.O_ACCMODE != os.O_RDONLY or not file.target.startswith("/"):
            return False
        device = self._link(file.descriptor).stat().st_dev
        return device not in self._writeable_devices()

    def _writeable_devices(self) -> set[int]:
        return {folder.stat().st_dev for folder in self._writeable_folders}

    def _restore_files(self) -> bool:
        now = {file.descriptor: file for file in self._open_files()}
        for before in self._files:
            after = now.get(before.descriptor)
            if after is None or replace(after, position=before.position) != before:
                return False
            if after.position != before.position:
                self._process.call(tracing.SYS_LSEEK, before.descriptor, before.position, os.SEEK_SET)
        return True

    def _reset_times(self) -> None:
        """Set the times of output and channel to zero; else they would show when an earlier episode printed."""
        for file in self._files:
            if file.target not in DEVICES and file.target in self._own_files:
                try:
                    os.utime(self._link(file.descriptor), ns=(0, 0))
                except FileNotFoundError as error:
                    raise TracedProcessGone from error

    def _link(self, descriptor: int) -> Path:
        return Path(f"/proc/{self.pid}/fd/{descriptor}")

    def _open_files(self) -> list[OpenFile]:
        files = []
        try:
            with os.scandir(f"/proc/{self.pid}/fd") as links:
                for link in links:
                    lines = process_tree.read_text_file(f"/proc/{self.pid}/fdinfo/{link.name}").splitlines()
                    info = dict(line.split(":", 1) for line in lines if line.startswith(("pos:", "flags:")))
                    state = link.stat()
                    files.append(
                        OpenFile(
                            descriptor=int(link.name),
                            target=os.readlink(link.path),  # noqa: PTH115 - a Path takes ten times as long
                            position=int(info["pos"]),
                            flags=int(info["flags"], 8),
                            mode=state.st_mode,
                            owner=(state.st_uid, state.st_gid),
                            locks=tuple(line for line in lines if line.startswith("lock:")),
                        )
                    )
        except FileNotFoundError as error:
            raise TracedProcessGone from error
        return sorted(files, key=lambda file: file.descriptor)

    # Memory

    def _check_memory(self) -> None:
        writeable = {(os.major(device), os.minor(device)) for device in self._writeable_devices()}
        for line in Path(f"/proc/{self.pid}/maps").read_text(errors="replace").splitlines():
            _, permissions, _, device, inode, *name = line.split(maxsplit=5)
            if not permissions.endswith("s"):
                continue
            major, minor = (int(part, 16) for part in device.split(":"))
            if (major, minor) in writeable or "w" in permissions or _is_anonymous(name, inode):
                raise PolicyFailed(
                    VerdictCode.SHARED_STATE,
                    f"After loading, the policy held shared memory ({' '.join(name) or 'anonymous'}); all "
                    "episodes would write to the same. Use ordinary (private) memory.",
                )

    def _check_threads(self) -> None:
        if len(list(Path(f"/proc/{self.pid}/task").iterdir())) != 1:
            raise PolicyFailed(
                VerdictCode.PROTOCOL_VIOLATION, "After loading, the process that answers had more than one thread."
            )

    def _pending_signals(self) -> list[str]:
        """Return the pending signals of the frozen process as /proc shows them; they count against its user's limit."""
        try:
            lines = process_tree.read_text_file(f"/proc/{self.pid}/status").splitlines()
        except FileNotFoundError as error:
            raise TracedProcessGone from error
        return [line for line in lines if line.startswith(("SigQ:", "SigPnd:", "ShdPnd:"))]

    def _limit_cpu(self, soft_s: int) -> None:
        """Set the limit that the copies inherit; each copy's CPU time starts from zero."""
        place = self._process.scratch_address
        self._process.write(place, struct.pack("<QQ", soft_s, soft_s + 1))
        self._process.call(tracing.SYS_SETRLIMIT, resource.RLIMIT_CPU, place)

    def _find_tid_address(self) -> int:
        """Return where the C library keeps the thread's id, so that it is right in every copy."""
        place = self._process.scratch_address
        self._process.call(tracing.SYS_PRCTL, _PR_GET_TID_ADDRESS, place)
        return self._process.read_word(place)

    # Temporary files

    @cached_property
    def _writeable_folders(self) -> tuple[Path, ...]:
        return tuple(Path(f"/proc/{self.pid}/root", folder) for folder in _WRITEABLE_FOLDERS)

    def _folder_states(self) -> list[tuple[int, ...]]:
        """Return what a policy can change about its two folders; what is made or removed in one shows in its times."""
        try:
            states = [folder.stat() for folder in self._writeable_folders]
        except FileNotFoundError as error:
            raise TracedProcessGone from error
        return [
            (s.st_mode, s.st_uid, s.st_gid, s.st_nlink, s.st_ctime_ns, s.st_mtime_ns, s.st_atime_ns) for s in states
        ]

    def _wipe(self) -> None:
        """Empty the writeable folders after loading."""
        for folder in self._writeable_folders:
            folder.chmod(_FOLDER_MODE)
            if _make_readable(folder, _WIPED_DEPTH_MAX) > _WIPED_ENTRIES_MAX:
                raise PolicyFailed(
                    VerdictCode.SHARED_STATE,
                    f"While loading, the policy left more than {_WIPED_ENTRIES_MAX} files (or folders more than "
                    f"{_WIPED_DEPTH_MAX} deep) in a temporary folder; leave less.",
                )
            for entry in os.scandir(folder):
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path)
                else:
                    Path(entry.path).unlink()
            # So that no file is made and removed within the same tick of the file system's clock without a trace.
            os.utime(folder, ns=(time.time_ns(), 0))
            list(folder.iterdir())  # so that a policy that lists it does not change its time of access


def _is_anonymous(name: list[str], inode: str) -> bool:
    return not name or inode == "0" or name[0].startswith(("/dev/zero", "/memfd:", "/SYSV"))


def _describe(file: OpenFile) -> str:
    if file.target.startswith(("pipe:", "socket:", "anon_inode:")):
        return f"descriptor {file.descriptor} ({file.target.partition(':')[0]})"
    how = "for reading" if file.flags & os.O_ACCMODE == os.O_RDONLY else "for writing"
    return f"the file {file.target} ({how})"


def _make_readable(folder: Path, depth: int) -> int:
    """Make the folders below a folder readable, and return how many entries there are; too deep counts as too many."""
    count = 0
    with os.scandir(folder) as entries:
        for entry in entries:
            count += 1
            if entry.is_dir(follow_symlinks=False):
                Path(entry.path).chmod(0o700)
                count += _make_readable(Path(entry.path), depth - 1) if depth else _WIPED_ENTRIES_MAX + 1
            if count > _WIPED_ENTRIES_MAX:
                return count
    return count
