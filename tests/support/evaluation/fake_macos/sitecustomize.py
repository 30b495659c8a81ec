"""Takes away what Linux alone has and says that this is macOS, in each Python process that finds this file.

Compiled packages that choose their libraries by the system are loaded before.
"""

import builtins
import contextlib
import ctypes
import fcntl
import io
import os
import platform
import resource
import select
import signal
import socket
import sys
import sysconfig
from typing import Any

sysconfig.get_config_vars()
with contextlib.suppress(ImportError):
    import numba  # noqa: F401

LINUX_ONLY: dict[Any, tuple[str, ...]] = {
    os: (
        "copy_file_range", "eventfd", "getrandom", "memfd_create", "pidfd_open", "posix_fadvise", "sched_getaffinity",
        "sched_setaffinity", "setns", "splice", "unshare",
    ),
    socket: ("AF_NETLINK", "MSG_CMSG_CLOEXEC", "SCM_CREDENTIALS", "SOCK_CLOEXEC", "SO_PASSCRED", "SO_PEERCRED"),
    signal: ("SIGPWR", "SIGSTKFLT", "pidfd_send_signal"),
    select: ("epoll",),
    fcntl: ("F_ADD_SEALS", "F_GETLEASE", "F_SETLEASE", "F_SETPIPE_SZ"),
    resource: ("prlimit",),
}  # fmt: skip
LINUX_CALLS = frozenset({"prctl", "sched_getcpu", "setns", "unshare"})
LINUX_FOLDERS = ("/proc", "/sys/fs")

for module, names in LINUX_ONLY.items():
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
sys.platform = "darwin"
platform.system = lambda: "Darwin"
platform.machine = lambda: "arm64"


class Library(ctypes.CDLL):
    """A C library without the calls of Linux."""

    def __getattr__(self, name: str) -> Any:
        if name in LINUX_CALLS:
            raise AttributeError(name)
        return super().__getattr__(name)


ctypes.CDLL = Library  # type: ignore[misc]


def without_linux(call: Any) -> Any:
    """A call that opens files, for which the kernel's folders are not there."""

    def opened(file: Any, *arguments: Any, **options: Any) -> Any:
        if isinstance(file, str | os.PathLike) and str(file).startswith(LINUX_FOLDERS):
            raise FileNotFoundError(2, "No such file or directory", str(file))
        return call(file, *arguments, **options)

    return opened


builtins.open = io.open = without_linux(open)
os.open = without_linux(os.open)
