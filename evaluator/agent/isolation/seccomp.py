"""The system calls that no policy needs and that reach the kernel, other processes, or the next episode."""

import errno
import functools
import signal
import tempfile
from typing import Any, Final

from ..verdicts import SandboxFailed

_KERNEL: Final = [
    "acct",
    "add_key",
    "bpf",
    "clock_adjtime",
    "clock_settime",
    "delete_module",
    "fanotify_init",
    "fanotify_mark",
    "finit_module",
    "init_module",
    "io_uring_enter",
    "io_uring_register",
    "io_uring_setup",
    "ioperm",
    "iopl",
    "kexec_file_load",
    "kexec_load",
    "keyctl",
    "lookup_dcookie",
    "modify_ldt",
    "nfsservctl",
    "perf_event_open",
    "seccomp",
    "personality",
    "quotactl",
    "quotactl_fd",
    "reboot",
    "request_key",
    "sethostname",
    "setdomainname",
    "settimeofday",
    "stime",
    "swapoff",
    "swapon",
    "sysfs",
    "_sysctl",
    "syslog",
    "adjtimex",
    "userfaultfd",
    "uselib",
    "ustat",
    "vhangup",
    "vm86",
    "vm86old",
]
_NAMESPACES: Final = [
    "chroot",
    "fsconfig",
    "fsmount",
    "fsopen",
    "fspick",
    "mount",
    "mount_setattr",
    "move_mount",
    "name_to_handle_at",
    "open_by_handle_at",
    "open_tree",
    "pivot_root",
    "setns",
    "umount",
    "umount2",
    "unshare",
]
_OTHER_PROCESSES: Final = [
    "kcmp",
    "migrate_pages",
    "move_pages",
    "pidfd_getfd",
    "process_madvise",
    "process_mrelease",
    "process_vm_readv",
    "process_vm_writev",
    "ptrace",
    "get_robust_list",
]
# System V and POSIX message objects outlive the process that makes them; priorities of the loaded copy would be
# inherited by the next episode, and options of the channel's socket would be seen by it.
_SHARED_STATE: Final = [
    "memfd_create",
    "memfd_secret",
    "mq_getsetattr",
    "mq_notify",
    "mq_open",
    "mq_timedreceive",
    "mq_timedsend",
    "mq_unlink",
    "msgctl",
    "msgget",
    "msgrcv",
    "msgsnd",
    "semctl",
    "semget",
    "semop",
    "semtimedop",
    "shmat",
    "shmctl",
    "shmdt",
    "shmget",
    "ioprio_set",
    "sched_setattr",
    "sched_setparam",
    "sched_setscheduler",
    "setpriority",
    "setsockopt",
    "shutdown",
]
_PAGE_CACHE: Final = ["cachestat", "fadvise64", "io_setup", "io_submit", "mincore", "preadv2", "pwritev2", "readahead"]
"""They drop pages of a file from memory or tell which are there: a memory that every episode shares."""
DENIED: Final = (*_PAGE_CACHE, *_KERNEL, *_NAMESPACES, *_OTHER_PROCESSES, *_SHARED_STATE)

_NEW_NAMESPACE_FLAGS: Final = (
    0x00000080,
    0x00020000,
    0x02000000,
    0x04000000,
    0x08000000,
    0x10000000,
    0x20000000,
    0x40000000,
)
"""CLONE_NEWTIME, NEWNS, NEWCGROUP, NEWUTS, NEWIPC, NEWUSER, NEWPID, NEWNET."""
_AF_UNIX: Final = 1
_TERMINAL_INJECTION: Final = (0x5412, 0x541C)
"""TIOCSTI, TIOCLINUX."""
_IOCTLS: Final = (*_TERMINAL_INJECTION, 0x8901, 0x8902)
"""With FIOSETOWN and SIOCSPGRP, see `_FCNTLS`."""
_FCNTLS: Final = (8, 10, 15, 1024, 1026, 1031, 1033, 1036, 1038)
"""F_SETOWN, SETSIG, SETOWN_EX, SETLEASE, NOTIFY, SETPIPE_SZ, ADD_SEALS, SET_RW_HINT, SET_FILE_RW_HINT: they write to an
open file that later episodes inherit as well."""
_PRCTLS: Final = (22, 62)
"""PR_SET_SECCOMP: with a filter of its own a policy could fake the calls that are made in its name to clear up after an
episode. PR_SCHED_CORE: marks other processes."""
_SIGNAL_CALLS: Final = {
    "kill": 1,
    "tkill": 1,
    "tgkill": 2,
    "rt_sigqueueinfo": 1,
    "rt_tgsigqueueinfo": 2,
    "pidfd_send_signal": 1,
}
"""Which argument of a call is the signal."""
_JOB_CONTROL: Final = (signal.SIGCONT, signal.SIGSTOP)
"""They stop a traced process even where it blocks them, so that a flood of them would keep the
evaluator from freezing the loaded policy."""
_NEGATIVE: Final = 0x80000000
"""Clocks of other processes have negative numbers; that of the first process runs with every process it buries."""
_O_TMPFILE: Final = 0x00400000
"""Nameless files leave no trace in a folder's times, but advance its inode numbers."""
_LOW_WORD: Final = 0xFFFFFFFF


@functools.cache
def filter_program() -> bytes:
    """Return the filter as the BPF program that bubblewrap loads.

    Raises:
        SandboxFailed: libseccomp is missing.
    """
    try:
        import pyseccomp  # type: ignore[import-untyped]
    except (ImportError, OSError, RuntimeError) as error:
        raise SandboxFailed(
            f"The seccomp filter cannot be built ({error}); install libseccomp (Debian, Ubuntu: `libseccomp2`)."
        ) from error
    syscall_filter = pyseccomp.SyscallFilter(pyseccomp.ALLOW)
    _add_rules(syscall_filter, pyseccomp)
    with tempfile.TemporaryFile() as file:
        syscall_filter.export_bpf(file)
        file.seek(0)
        return file.read()


def _add_rules(syscall_filter: Any, seccomp: Any) -> None:
    refuse = seccomp.ERRNO(errno.EPERM)
    low_bits, unequal = seccomp.MASKED_EQ, seccomp.NE
    for name in DENIED:
        if seccomp.resolve_syscall(seccomp.Arch.NATIVE, name) >= 0:
            syscall_filter.add_rule(refuse, name)
    # clone3 hides its flags from a filter; with ENOSYS the C library falls back to clone.
    syscall_filter.add_rule(seccomp.ERRNO(errno.ENOSYS), "clone3")
    for flag in _NEW_NAMESPACE_FLAGS:
        syscall_filter.add_rule(refuse, "clone", seccomp.Arg(0, low_bits, flag, flag))
    for name in ("socket", "socketpair"):
        syscall_filter.add_rule(refuse, name, seccomp.Arg(0, unequal, _AF_UNIX))
    for request in _IOCTLS:
        syscall_filter.add_rule(refuse, "ioctl", seccomp.Arg(1, low_bits, _LOW_WORD, request))
    for command in _FCNTLS:
        syscall_filter.add_rule(refuse, "fcntl", seccomp.Arg(1, low_bits, _LOW_WORD, command))
    for option in _PRCTLS:
        syscall_filter.add_rule(refuse, "prctl", seccomp.Arg(0, low_bits, _LOW_WORD, option))
    for name, place in _SIGNAL_CALLS.items():
        for number in _JOB_CONTROL:
            syscall_filter.add_rule(refuse, name, seccomp.Arg(place, low_bits, _LOW_WORD, number))
    syscall_filter.add_rule(
        seccomp.ERRNO(errno.EINVAL), "clock_gettime", seccomp.Arg(0, low_bits, _NEGATIVE, _NEGATIVE)
    )
    syscall_filter.add_rule(seccomp.ERRNO(errno.ENOSYS), "openat2")
    for name, position in (("open", 1), ("openat", 2)):
        nameless = seccomp.Arg(position, low_bits, _O_TMPFILE, _O_TMPFILE)
        syscall_filter.add_rule(seccomp.ERRNO(errno.EOPNOTSUPP), name, nameless)
    # Own limits and affinity (process 0) may be changed, those of others not.
    for name in ("prlimit64", "sched_setaffinity"):
        syscall_filter.add_rule(refuse, name, seccomp.Arg(0, seccomp.GT, 0))
