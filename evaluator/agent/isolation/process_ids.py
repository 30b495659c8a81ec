"""Makes a sandbox count its process ids from the same number in every episode; they would number the episodes."""

import fcntl
import os
import select
import shutil
import subprocess
from contextlib import ExitStack
from pathlib import Path
from typing import Final, Self

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
        ready, _, _ = select.select([self._shell.stdout], [], [], _DEADLINE_S)
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
