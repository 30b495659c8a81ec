"""Processes of a sandbox, found and watched from outside: their tree, and their ids inside and outside."""

import contextlib
import fcntl
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from multiprocessing.connection import wait
from pathlib import Path
from typing import Final, Self

_PAGE_BYTES: Final = os.sysconf("SC_PAGE_SIZE")
_TICKS_PER_S: Final = os.sysconf("SC_CLK_TCK")
_CHUNK_BYTES: Final = 65536
_CHILDREN_TIMES: Final = slice(13, 15)
"""cutime and cstime of /proc/PID/stat, counted from the field after the name."""
_GONE: Final = (FileNotFoundError, ProcessLookupError)
"""What reading /proc raises for a process that has ended."""


def read_text_file(file: str) -> str:
    """Return what a file of /proc says; read several times for each episode, and `read_text` takes four times as long.

    Raises:
        OSError: the process, or what the file is about, is gone, or may not be read.
    """
    descriptor = os.open(file, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return b"".join(iter(lambda: os.read(descriptor, _CHUNK_BYTES), b"")).decode(errors="replace")
    finally:
        os.close(descriptor)


def descendants(first_pid: int) -> Iterator[int]:
    """Yield the pids below a process; orphans of a pid namespace hang below its first process, so none is missed."""
    waiting = [first_pid]
    while waiting:
        for child in _children(waiting.pop()):
            yield child
            waiting.append(child)


def _children(pid: int) -> list[int]:
    children: list[int] = []
    with contextlib.suppress(*_GONE):
        for task in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(*_GONE):
                children += map(int, read_text_file(f"{task}/children").split())
    return children


def cpu_s(pid: int) -> float:
    """Return the CPU time that a process has used [s], 0 where it has ended.

    Its CPU clock can be read without any right over it (the encoding of clock_getcpuclockid).
    """
    try:
        return time.clock_gettime((~pid << 3) | 2)
    except OSError:
        return 0.0


def reaped_cpu_s(pid: int) -> float:
    """Return the CPU time of the children that a process has waited for, and of theirs [s]; 0 where it has ended.

    Children that end while their parent ignores SIGCHLD are in nobody's count.
    """
    with contextlib.suppress(*_GONE):
        fields = read_text_file(f"/proc/{pid}/stat").rpartition(")")[2].split()
        return sum(map(int, fields[_CHILDREN_TIMES])) / _TICKS_PER_S
    return 0.0


def resident_bytes(pid: int) -> int:
    """Return resident memory of a process, 0 where it has ended."""
    with contextlib.suppress(*_GONE):
        return int(read_text_file(f"/proc/{pid}/statm").split()[1]) * _PAGE_BYTES
    return 0


def proportional_bytes(pid: int) -> int:
    """Return resident memory of a process, shared pages divided among their sharers; 0 where it has ended.

    A process may hide this from its own user; then shared pages are counted in full.
    """
    try:
        lines = read_text_file(f"/proc/{pid}/smaps_rollup").splitlines()
    except (PermissionError, *_GONE):
        return resident_bytes(pid)
    return sum(int(line.split()[1]) * 1024 for line in lines if line.startswith("Pss:"))


def inside_pid(pid: int) -> int:
    """Return a process's pid in its own (innermost) pid namespace.

    Raises:
        ProcessLookupError: it has ended.
    """
    try:
        lines = read_text_file(f"/proc/{pid}/status").splitlines()
    except FileNotFoundError as error:
        raise ProcessLookupError(pid) from error
    return next(int(line.split()[-1]) for line in lines if line.startswith("NSpid:"))


def kill_descendants(first_pid: int, *, spared_pid: int = 0) -> None:
    """Kill the processes below a process; a later process that got the pid of one of them is left alone."""
    with contextlib.ExitStack() as exits:
        handles = {}
        for pid in descendants(first_pid):
            with contextlib.suppress(ProcessLookupError):
                handles[pid] = os.pidfd_open(pid)
                exits.callback(os.close, handles[pid])
        for pid in handles.keys() & set(descendants(first_pid)) - {spared_pid}:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(handles[pid], signal.SIGKILL)


_NS_GET_USERNS: Final = 0xB701
_SET_LAST_PIDS: Final = """
while read -r last; do
  if (echo "$last" > /proc/sys/kernel/ns_last_pid) 2> /dev/null; then echo set; else echo refused; fi
done
"""
"""Only what is in brackets runs inside the namespace: the shell itself stays outside, where no policy sees it."""
_DEADLINE_S: Final = 10.0


class ProcessIds:
    """The counter of process ids of one sandbox.

    Only a process inside the pid namespace, with rights over the user namespace that owns it, may set the counter; the
    evaluator has these rights as root, or as the user who made the namespaces. A shell waits for the numbers, because
    starting one takes longer than most policies think.

    Args:
        first_pid: first process of the sandbox, outside.
    """

    def __init__(self, first_pid: int) -> None:
        self._first_pid = first_pid
        self._exits = ExitStack()
        self._shell: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Self:
        program = shutil.which("nsenter")
        if program is not None:
            self._shell = self._exits.enter_context(self._started(program))
            self._exits.callback(self._shell.kill)
        return self

    def __exit__(self, *exception: object) -> None:
        self._shell = None
        self._exits.close()

    @property
    def pids(self) -> tuple[int, ...]:
        """Process of the shell; none where this machine cannot set the counter."""
        return () if self._shell is None else (self._shell.pid,)

    def continue_after(self, inside_pid: int) -> bool:
        """Let the next process get the first free id above this one; return whether this machine can do that."""
        if self._shell is None or self._shell.stdin is None or self._shell.stdout is None:
            return False
        try:
            self._shell.stdin.write(b"%d\n" % inside_pid)
        except BrokenPipeError:
            return False
        ready = wait([self._shell.stdout.fileno()], _DEADLINE_S)
        return bool(ready) and self._shell.stdout.readline() == b"set\n"

    def _started(self, program: str) -> "subprocess.Popen[bytes]":
        """Start the shell, whose children are inside the pid namespace."""
        pid_namespace = os.open(f"/proc/{self._first_pid}/ns/pid", os.O_RDONLY)
        try:
            owner = fcntl.ioctl(pid_namespace, _NS_GET_USERNS)
            try:
                command = [program, *_user_namespace(owner), f"--pid=/proc/self/fd/{pid_namespace}", "--no-fork"]
                return subprocess.Popen(  # noqa: S603 - programs of the system and text of ours
                    [*command, "--", "/bin/sh", "-c", _SET_LAST_PIDS],
                    pass_fds=(pid_namespace, owner),
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    bufsize=0,
                    env={},
                )
            finally:
                os.close(owner)
        finally:
            os.close(pid_namespace)


def _user_namespace(owner: int) -> list[str]:
    own = Path("/proc/self/ns/user").readlink()
    if Path(f"/proc/self/fd/{owner}").readlink() == own:
        return []
    return ["--preserve-credentials", f"--user=/proc/self/fd/{owner}"]
