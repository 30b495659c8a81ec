"""The system calls that a policy may make; every other one is answered as if the kernel did not have it (ENOSYS).

An allow-list, because kernels grow: `statmount` and `listmount` (Linux 6.8) would tell paths of the host, and Landlock
could hide processes from the evaluator. ENOSYS, because C libraries fall back from a new call to an older one then.
"""

import errno
import functools
import signal
import tempfile
from collections.abc import Iterable
from typing import Any, Final

from ..verdicts import SandboxFailed

_MEMORY: Final = """
    brk get_mempolicy madvise membarrier mlock mlock2 mlockall mmap mprotect mremap msync munlock munlockall munmap
    pkey_alloc pkey_free pkey_mprotect set_mempolicy
"""
_FILES: Final = """
    access chdir chmod chown close close_range copy_file_range creat dup dup2 dup3 faccessat faccessat2 fallocate
    fchdir fchmod fchmodat fchmodat2 fchown fchownat fdatasync fgetxattr flistxattr fstat fsync ftruncate
    getcwd getdents getdents64 getxattr lchown lgetxattr link linkat listxattr llistxattr lseek lstat mkdir mkdirat
    mknod mknodat newfstatat pread64 preadv pwrite64 pwritev read readlink readlinkat readv rename renameat renameat2
    rmdir sendfile stat symlink symlinkat truncate umask unlink unlinkat write writev
"""
_WAITING: Final = """
    epoll_create epoll_create1 epoll_ctl epoll_ctl_old epoll_pwait epoll_pwait2 epoll_wait epoll_wait_old eventfd
    eventfd2 poll ppoll pselect6 select
    signalfd signalfd4 splice tee vmsplice
"""
_CHANNEL: Final = """
    getpeername getsockname recvfrom recvmmsg recvmsg sendmmsg sendmsg sendto
"""
"""Only the channel is a socket. Pipes and sockets of the kernel's own are numbered by counters of the whole machine
(`st_ino`), which earlier episodes could advance; the runtime's `os.pipe` makes named pipes. Nor is there `statx`, which
gives the numbers of mounts."""
_PROCESSES: Final = """
    capget capset execve execveat exit exit_group fork getcpu getegid geteuid getgid getgroups getpgid getpgrp getpid
    getppid getpriority getresgid getresuid getrlimit getsid gettid getuid ioprio_get setfsgid setfsuid setgid
    setgroups setpgid setregid setresgid setresuid setreuid setrlimit setsid setuid uname vfork
"""
_THREADS: Final = """
    arch_prctl futex get_thread_area rseq sched_get_priority_max sched_get_priority_min sched_getaffinity sched_getattr
    sched_getparam sched_getscheduler sched_rr_get_interval sched_yield set_robust_list set_thread_area set_tid_address
"""
_SIGNALS_AND_TIME: Final = """
    alarm getitimer getrandom gettimeofday nanosleep pause restart_syscall rt_sigaction rt_sigpending rt_sigprocmask
    rt_sigreturn rt_sigsuspend rt_sigtimedwait setitimer sigaltstack time timer_delete timer_getoverrun timer_gettime
    timer_settime timerfd_create timerfd_gettime timerfd_settime times
"""
ALLOWED: Final = tuple(" ".join((_MEMORY, _FILES, _WAITING, _CHANNEL, _PROCESSES, _THREADS, _SIGNALS_AND_TIME)).split())
"""Calls that may be made with any arguments."""

_TIMES_OF_FILES: Final = ("futimesat", "utime", "utimensat", "utimes")
"""These calls succeed and do nothing: the device nodes, the output and the channel are the same in every
episode (the nodes even the host's), and whoever may write to a file may set its times."""
_NEW_NAMESPACE_FLAGS: Final = 0x7E020080
"""CLONE_NEWTIME, NEWNS, NEWCGROUP, NEWUTS, NEWIPC, NEWUSER, NEWPID, NEWNET."""
_CLONE_PIDFD: Final = 0x00001000
"""A descriptor of a process has the number that the whole machine's processes are counted by (`st_ino`); nor is there
`pidfd_open`, or the socket option that gives one."""
_SOCKET_OPTIONS: Final = (2, 3, 4, 6, 7, 8, 9, 13, 16, 17, 18, 19, 20, 21, 30, 31, 38, 39, 66, 67)
"""Type, error, buffers, credentials, time-outs and the like. Not SO_COOKIE, which numbers the sockets of the whole
machine, nor SO_PEERPIDFD, nor what later kernels add."""
_LOW_BYTE_ONLY: Final = 0xFFFFFF00
_IOCTLS: Final = (0x5401, 0x540F, 0x5413, 0x541B, 0x5421, 0x5450, 0x5451)
"""TCGETS (is it a terminal), TIOCGPGRP, TIOCGWINSZ, FIONREAD, FIONBIO, FIONCLEX, FIOCLEX."""
_GPU_CALLS: Final = ("pipe2",)
"""The driver's threads wake each other by pipes of the kernel's own, although these are numbered for the whole machine:
so are many things that a GPU tells of those who used it before."""
_GPU_IOCTLS: Final = ((0xFF00, 0x4600), (_LOW_BYTE_ONLY, 0), (0xFFFFFFFF, 0x30000001), (0xFFFFFFFF, 0x30000002))
"""Mask and value of what the driver of a GPU is asked: its own calls, of type F, and those about memory, which are
small numbers and two large ones. No terminal is asked by such a number."""
_FCNTLS: Final = (0, 1, 2, 3, 4, 9, 11, 16, 1030, 1032, 1034, 1035, 1037)
"""Neither locks and leases, which sandboxes that run side by side would see on the files that they share (nor is there
`flock`, `inotify_init` or `statfs`), nor what writes to an open file that later episodes inherit as well: F_SETOWN,
SETSIG, SETOWN_EX, NOTIFY, SETPIPE_SZ, ADD_SEALS, SET_RW_HINT, SET_FILE_RW_HINT."""
_PRCTLS: Final = (1, 2, 3, 4, 7, 8, 13, 14, 15, 16, 21, 23, 29, 30, 36, 37, 38, 39, 40, 41, 42, 47)
"""Parent-death signal, dumpable, keepcaps, timing, name, GET_SECCOMP, CAPBSET_READ, timer slack, subreaper,
no_new_privs, GET_TID_ADDRESS, THP_DISABLE, CAP_AMBIENT. Not SET_SECCOMP: with a filter of its own a policy could fake
the calls that are made in its name to clear up after an episode."""
_SIGNAL_CALLS: Final = {
    "kill": 1,
    "tkill": 1,
    "tgkill": 2,
    "rt_sigqueueinfo": 1,
    "rt_tgsigqueueinfo": 2,
}
"""Which argument of a call is the signal."""
_SIGNAL_BITS: Final = 7
_CLOCK_CALLS: Final = ("clock_getres", "clock_gettime", "clock_nanosleep", "timer_create")
"""Their first argument is a clock."""
_NEGATIVE: Final = 0x80000000
"""Clocks of other processes have negative numbers; that of the first process advances with every process it reaps."""
_O_TMPFILE: Final = 0x00400000
"""Nameless files leave no trace in a folder's times, but advance its inode numbers."""
_LOW_WORD: Final = 0xFFFFFFFF


@functools.cache
def filter_program(further: tuple[str, ...] = (), *, has_gpu: bool = False) -> bytes:
    """Return the filter as the BPF program that bubblewrap loads.

    Args:
        further: calls that may be made besides, such as those that need a right which is given up first.
        has_gpu: whether the driver of a GPU may be asked.

    Raises:
        SandboxFailed: libseccomp is missing.
    """
    pyseccomp = _load_library()
    syscall_filter = pyseccomp.SyscallFilter(pyseccomp.ERRNO(errno.ENOSYS))
    _add_rules(
        syscall_filter,
        pyseccomp,
        (*ALLOWED, *further, *(_GPU_CALLS if has_gpu else ())),
        _GPU_IOCTLS if has_gpu else (),
    )
    with tempfile.TemporaryFile() as file:
        syscall_filter.export_bpf(file)
        file.seek(0)
        return file.read()


def call_numbers(names: Iterable[str]) -> dict[str, int]:
    """Return the numbers of system calls, which differ between architectures, on this machine; -1 for unknown ones.

    Raises:
        SandboxFailed: libseccomp is missing.
    """
    library = _load_library()
    return {name: library.resolve_syscall(library.Arch.NATIVE, name) for name in names}


def _load_library() -> Any:
    try:
        import pyseccomp  # type: ignore[import-untyped]
    except (ImportError, OSError, RuntimeError) as error:
        raise SandboxFailed(
            f"The seccomp filter cannot be built ({error}); install libseccomp (Debian, Ubuntu: `libseccomp2`)."
        ) from error
    return pyseccomp


def _add_rules(
    syscall_filter: Any, seccomp: Any, allowed: tuple[str, ...], further_ioctls: tuple[tuple[int, int], ...]
) -> None:
    def add(action: Any, name: str, *conditions: Any) -> None:
        if seccomp.resolve_syscall(seccomp.Arch.NATIVE, name) >= 0:
            syscall_filter.add_rule(action, name, *conditions)

    def allow_only(name: str, position: int, values: tuple[int, ...], mask: int = _LOW_WORD) -> None:
        for value in values:
            add(seccomp.ALLOW, name, seccomp.Arg(position, seccomp.MASKED_EQ, mask, value))

    for name in allowed:
        add(seccomp.ALLOW, name)
    for name in _TIMES_OF_FILES:
        add(seccomp.ERRNO(0), name)
    allow_only("ioctl", 1, _IOCTLS)
    for mask, value in further_ioctls:
        allow_only("ioctl", 1, (value,), mask=mask)
    allow_only("fcntl", 1, _FCNTLS)
    allow_only("prctl", 0, _PRCTLS)
    allow_only("clone", 0, (0,), mask=_NEW_NAMESPACE_FLAGS | _CLONE_PIDFD)
    allow_only("getsockopt", 2, _SOCKET_OPTIONS)
    for name in _CLOCK_CALLS:
        allow_only(name, 0, (0,), mask=_NEGATIVE)
    allow_only("open", 1, (0,), mask=_O_TMPFILE)
    allow_only("openat", 2, (0,), mask=_O_TMPFILE)
    # Own limits and affinity (process 0) may be changed, those of others not.
    for name in ("prlimit64", "sched_setaffinity"):
        add(seccomp.ALLOW, name, seccomp.Arg(0, seccomp.EQ, 0))
    # Without resource usage, which counts the pages that were not in the host's page cache; nor is there getrusage.
    for name, position in (("wait4", 3), ("waitid", 4)):
        add(seccomp.ALLOW, name, seccomp.Arg(position, seccomp.EQ, 0))
    for name, position in _SIGNAL_CALLS.items():
        for bit in _bits_that_differ_from_job_control():
            allow_only(name, position, (bit & ~signal.SIGCONT,), mask=bit)


def _bits_that_differ_from_job_control() -> list[int]:
    """Return the bits of a signal's number of which one differs from SIGCONT and SIGSTOP in every other signal.

    These two stop a traced process even where it blocks them, so that a flood of them would keep the evaluator from
    freezing the loaded policy. Their numbers differ in the lowest bit alone.
    """
    return [1 << number for number in range(_SIGNAL_BITS) if not (signal.SIGCONT ^ signal.SIGSTOP) >> number & 1]
