"""Makes a sandbox count its process ids from the same number in every episode; they would number the episodes."""

import fcntl
import os
import shutil
import subprocess
from pathlib import Path
from types import TracebackType
from typing import Final, Self

_NS_GET_USERNS: Final = 0xB701
_SET_LAST_PID: Final = 'echo "$1" > /proc/sys/kernel/ns_last_pid'
_DEADLINE_S: Final = 10.0


class ProcessIds:
    """The counter of process ids of one sandbox.

    Only a process inside the pid namespace, with rights over the user namespace that owns it, may set the counter; the
    evaluator has these rights as root, or as the user who made the namespaces.

    Args:
        first_pid: first process of the sandbox, outside.
    """

    def __init__(self, first_pid: int) -> None:
        self._pid_namespace = os.open(f"/proc/{first_pid}/ns/pid", os.O_RDONLY)
        self._owner = fcntl.ioctl(self._pid_namespace, _NS_GET_USERNS)
        self._program = shutil.which("nsenter")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._pid_namespace)
        os.close(self._owner)

    def continue_after(self, inside_pid: int) -> bool:
        """Let the next process get the first free id above this one; return whether this machine can do that."""
        if self._program is None:
            return False
        command = [self._program, *self._user_namespace(), f"--pid=/proc/self/fd/{self._pid_namespace}"]
        done = subprocess.run(  # noqa: S603 - a program and numbers of ours
            [*command, "--", "/bin/sh", "-c", _SET_LAST_PID, "sh", str(inside_pid)],
            pass_fds=(self._pid_namespace, self._owner),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            env={},
            timeout=_DEADLINE_S,
            check=False,
        )
        return done.returncode == 0

    def _user_namespace(self) -> list[str]:
        own = Path("/proc/self/ns/user").readlink()
        if Path(f"/proc/self/fd/{self._owner}").readlink() == own:
            return []
        return ["--preserve-credentials", f"--user=/proc/self/fd/{self._owner}"]
