"""Control groups around one sandbox: version 2 where it is delegated to us, version 1 for root, else none."""

import contextlib
import itertools
import os
import signal
import time
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Final

from ..limits import Limits
from ..verdicts import SandboxFailed
from .bubblewrap import OWN_PROCESSES

_ROOT: Final = Path("/sys/fs/cgroup")
_MEMBERSHIP: Final = Path("/proc/self/cgroup")
_PREFIX: Final = "vitac-"
_REMOVE_DEADLINE_S: Final = 20.0
_LONGEST_COUNTER_BYTES: Final = 4096
_counter = itertools.count(1)


class MemoryIsolation(StrEnum):
    """What keeps many processes together below the memory limit."""

    CGROUP_V2 = "cgroup-v2"
    CGROUP_V1 = "cgroup-v1"
    WATCHDOG = "watchdog"
    """No control group: resident memory is looked at several times a second."""


class KeptOpen:
    """A file of the kernel that is read several times for each action; opening it takes four times as long as reading.

    Args:
        file: is opened at once; `close` has to be called.
    """

    def __init__(self, file: Path) -> None:
        self._descriptor = os.open(file, os.O_RDONLY | os.O_CLOEXEC)

    def content(self) -> str:
        """Return what the file says now."""
        return os.pread(self._descriptor, _LONGEST_COUNTER_BYTES, 0).decode()

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)


@dataclass(frozen=True, kw_only=True)
class ControlGroup:
    """The folders of one control group; version 1 has one for each controller."""

    isolation: MemoryIsolation
    memory: Path
    pids: Path
    cpu: Path

    @property
    def folders(self) -> tuple[Path, ...]:
        """Every folder once."""
        return tuple(dict.fromkeys((self.memory, self.pids, self.cpu)))

    def out_of_memory_kills(self) -> int:
        """Return how many processes the kernel has killed for lack of memory."""
        return _read_number("oom_kill", self._memory_counter.content())

    def refused_forks(self) -> int:
        """Return how often a process or thread was refused."""
        return _read_number("max", self._pids_counter.content())

    def cpu_s(self) -> float:
        """Return CPU time used by everything that was ever in the group [s]."""
        content = self._cpu_counter.content()
        if self._is_v2:
            return _read_number("usage_usec", content) * 1e-6
        return int(content) * 1e-9

    @cached_property
    def _memory_counter(self) -> KeptOpen:
        return KeptOpen(self.memory / ("memory.events" if self._is_v2 else "memory.oom_control"))

    @cached_property
    def _pids_counter(self) -> KeptOpen:
        return KeptOpen(self.pids / "pids.events")

    @cached_property
    def _cpu_counter(self) -> KeptOpen:
        return KeptOpen(self.cpu / ("cpu.stat" if self._is_v2 else "cpuacct.usage"))

    @property
    def _is_v2(self) -> bool:
        return self.isolation is MemoryIsolation.CGROUP_V2

    def remove(self) -> None:
        """Close what was read, and remove the folders; the kernel may need a moment after the last process was killed.

        Raises:
            SandboxFailed: a process is still inside.
        """
        for name in ("_memory_counter", "_pids_counter", "_cpu_counter"):
            counter = vars(self).pop(name, None)
            if counter is not None:
                counter.close()
        deadline = time.monotonic() + _REMOVE_DEADLINE_S
        for folder in self.folders:
            while not _remove(folder):
                if time.monotonic() > deadline:
                    raise SandboxFailed(f"Control group {folder} cannot be removed; a process of a sandbox still runs.")
                time.sleep(0.005)


def create(limits: Limits, *, root: Path = _ROOT, membership: Path = _MEMBERSHIP) -> ControlGroup | None:
    """Return a new control group with the limits set, or None where this process may not make one."""
    name = f"{_PREFIX}{os.getpid()}-{next(_counter)}"
    own = _own_groups(membership)
    for make in (_create_v2, _create_v1):
        try:
            group = make(root, own, name)
        except OSError:
            continue
        if group is not None and _set_limits(group, limits):
            return group
    return None


def memory_limit_bytes(*, root: Path = _ROOT, membership: Path = _MEMBERSHIP) -> int | None:
    """Return how much memory this process's groups let it use, such as those of a container; None without a limit.

    The smallest limit from the process's own group up to the root holds. Version 1 says that there is none by a number
    that is larger than any memory.
    """
    own, limits = _own_groups(membership), []
    for controller, top, name in (("", root, "memory.max"), ("memory", root / "memory", "memory.limit_in_bytes")):
        group = PurePosixPath("/", own.get(controller, ""))
        # In a container the path may be that of the host, of which only the last folder is mounted, as the root here.
        for each in (group, *group.parents):
            with contextlib.suppress(OSError, ValueError):  # it is not there, or says "max"
                limits.append(int((top / each.relative_to("/") / name).read_text()))
    return min(limits, default=None)


def sweep(parent: Path) -> None:
    """Remove the groups that evaluators which are no longer alive left behind, with what still runs in them.

    bubblewrap's first process waits for ever if its parent is killed before it has asked to die with it.
    """
    for folder in parent.glob(f"{_PREFIX}*"):
        owner = folder.name.removeprefix(_PREFIX).partition("-")[0]
        if owner.isdigit() and not Path("/proc", owner).exists() and not _remove(folder):
            _kill_processes(folder)


def _kill_processes(folder: Path) -> None:
    """Kill the processes of a group; those of another pid namespace have the number 0 here and are left alone."""
    with contextlib.suppress(OSError):
        for pid in map(int, (folder / "cgroup.procs").read_text().split()):
            if pid > 0:
                os.kill(pid, signal.SIGKILL)


def _own_groups(membership: Path) -> dict[str, str]:
    """Return controller -> path of this process's group; version 2 has the name ''."""
    groups = {}
    for line in membership.read_text().splitlines():
        _, controllers, path = line.split(":", 2)
        groups.update(dict.fromkeys(controllers.split(","), path))
    return groups


def _create_v2(root: Path, own: dict[str, str], name: str) -> ControlGroup | None:
    if "" not in own or not (root / "cgroup.controllers").exists():
        return None
    here = root / own[""].lstrip("/")
    for parent in (here, here.parent):
        if parent.is_relative_to(root) and _delegates(parent):
            sweep(parent)
            (parent / name).mkdir()
            folder = parent / name
            return ControlGroup(isolation=MemoryIsolation.CGROUP_V2, memory=folder, pids=folder, cpu=folder)
    return None


def _delegates(parent: Path) -> bool:
    """Return whether children of a group have memory and pids controllers, switching them on where allowed."""
    control = parent / "cgroup.subtree_control"
    if not os.access(parent, os.W_OK) or not control.exists():
        return False
    if {"memory", "pids"} <= set(control.read_text().split()):
        return True
    try:
        control.write_text("+memory +pids")
    except OSError:  # busy: a group with processes of its own cannot hand controllers on
        return False
    return {"memory", "pids"} <= set(control.read_text().split())


def _create_v1(root: Path, own: dict[str, str], name: str) -> ControlGroup | None:
    folders = {}
    for controller in ("memory", "pids", "cpuacct"):
        if controller not in own:
            return None
        parent = root / controller / own[controller].lstrip("/")
        parent = parent if parent.is_dir() else root / controller
        sweep(parent)
        folders[controller] = parent / name
    for folder in folders.values():
        folder.mkdir()
    return ControlGroup(
        isolation=MemoryIsolation.CGROUP_V1, memory=folders["memory"], pids=folders["pids"], cpu=folders["cpuacct"]
    )


def _set_limits(group: ControlGroup, limits: Limits) -> bool:
    memory = str(limits.memory_bytes)
    pairs = [(group.pids / "pids.max", str(limits.processes + OWN_PROCESSES))]
    if group.isolation is MemoryIsolation.CGROUP_V2:
        pairs += [(group.memory / "memory.max", memory), (group.memory / "memory.swap.max", "0")]
    else:
        pairs += [
            (group.memory / "memory.limit_in_bytes", memory),
            (group.memory / "memory.memsw.limit_in_bytes", memory),
        ]
    try:
        for file, value in pairs:
            if file.exists():
                file.write_text(value)
    except OSError:
        group.remove()
        return False
    return True


def _remove(folder: Path) -> bool:
    with contextlib.suppress(FileNotFoundError):
        try:
            folder.rmdir()
        except OSError:
            return False
    return True


def _read_number(name: str, content: str) -> int:
    for line in content.splitlines():
        name_read, _, value = line.partition(" ")
        if name_read == name:
            return int(value)
    return 0
