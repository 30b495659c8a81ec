"""Runs single system calls in a stopped process of the sandbox, without letting that process run one instruction.

Linux on x86-64 only (`explain_unsupported`). A traced process belongs to the thread that seized it.
"""

import contextlib
import ctypes
import os
import platform
import signal
import sys
import time
from pathlib import Path
from typing import Final

from ..verdicts import SandboxFailed

_PEEKTEXT, _CONT, _SETREGS, _GETREGS, _SYSCALL, _DETACH = 1, 7, 13, 12, 24, 17
_GETEVENTMSG, _SEIZE, _INTERRUPT, _GETSIGMASK, _SETSIGMASK = 0x4201, 0x4206, 0x4207, 0x420A, 0x420B
_SIGNAL_SET_BYTES: Final = 8
_ALL_SIGNALS: Final = (1 << 64) - 1
_OPTIONS: Final = 0x01 | 0x02 | 0x04 | 0x08 | 0x00100000
"""Mark system call stops; follow fork, vfork and clone; kill the traced process when the tracer's thread ends."""
_EVENT_FORKS: Final = (1, 2, 3)
_SYSCALL_STOP: Final = signal.SIGTRAP | 0x80
_ESRCH: Final = 3
_WAIT_ALL: Final = 0x40000000
_SYSCALL_INSTRUCTION: Final = b"\x0f\x05"
_NO_SYSCALL: Final = (1 << 64) - 1
_READING: Final = (0, 45, 47)
"""read, recvfrom, recvmsg: where a policy process waits for the next question."""
_INTERRUPTED: Final = (-512, -513, -514, -516)
"""ERESTARTSYS and its like: the call had not read anything yet and can be made again."""
_SIGNAL_CAME_FIRST: Final = -513
"""ERESTARTNOINTR of a fork: a signal waited, nothing was copied; made again it drops the signal."""
_STOPS_MAX: Final = 20_000
"""Signals that one system call may be interrupted by, before the process counts as lost."""
_FREEZE_DEADLINE_S: Final = 30.0
"""Long, because on a busy machine the process may not get to run for a while."""
_FREEZE_PAUSES_S: Final = (0.0005, 0.1)
"""First and longest time that it is left to run before it is looked at again."""

SYS_LSEEK: Final = 8
SYS_CLONE: Final = 56
SYS_KILL: Final = 62
SYS_PRCTL: Final = 157
SYS_SETRLIMIT: Final = 160


class _Registers(ctypes.Structure):
    """struct user_regs_struct."""

    _fields_ = [
        (name, ctypes.c_ulonglong)
        for name in [
            "r15",
            "r14",
            "r13",
            "r12",
            "rbp",
            "rbx",
            "r11",
            "r10",
            "r9",
            "r8",
            "rax",
            "rcx",
            "rdx",
            "rsi",
            "rdi",
            "orig_rax",
            "rip",
            "cs",
            "eflags",
            "rsp",
            "ss",
            "fs_base",
            "gs_base",
            "ds",
            "es",
            "fs",
            "gs",
        ]
    ]

    def copy(self) -> "_Registers":
        return _Registers.from_buffer_copy(self)


class TracedProcessGone(Exception):
    """The traced process has ended (somebody killed it); whatever was to be done with it has to start over."""


class NotWaiting(Exception):
    """The process does not wait for a question, or has more than one thread."""


_ptrace = ctypes.CDLL(None, use_errno=True).ptrace
_ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
_ptrace.restype = ctypes.c_long


def explain_unsupported(ptrace_scope: Path = Path("/proc/sys/kernel/yama/ptrace_scope")) -> str:
    """Return why no process can be traced here, by registers that are not known or by the kernel; empty if one can."""
    if sys.platform != "linux" or platform.machine() != "x86_64":
        return f"registers of {platform.machine()} are not known"
    if ptrace_scope.exists() and ptrace_scope.read_text().strip() == "3":
        return "kernel.yama.ptrace_scope is 3"
    return ""


class TracedProcess:
    """A process that stands still inside its read of the next question, for as long as this object exists."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._forked_pid = 0
        self._traced: set[int] = set()
        self._request(_SEIZE, 0, _OPTIONS)
        self._traced.add(pid)
        try:
            self._waiting = self._freeze_while_reading()
        except BaseException:
            self.end()
            raise

    def call(self, number: int, *arguments: int) -> int:
        """Let the process make one system call; return its result (a negative errno where it failed)."""
        registers = self._waiting.copy()
        registers.rip -= len(_SYSCALL_INSTRUCTION)
        registers.orig_rax = _NO_SYSCALL
        registers.rax = number
        values = [value & _NO_SYSCALL for value in arguments] + [0] * (6 - len(arguments))
        registers.rdi, registers.rsi, registers.rdx, registers.r10, registers.r8, registers.r9 = values
        self._set_registers(self.pid, registers)
        self._run_to_syscall_stop()
        self._run_to_syscall_stop()
        result: int = ctypes.c_longlong(self._registers(self.pid).rax).value
        self._set_registers(self.pid, self._waiting)
        return result

    def fork(self, flags: int, child_tid_address: int) -> tuple[int, int]:
        """Copy the process and let the copy continue reading; return its pid outside and inside the sandbox.

        Raises:
            OSError: the copy could not be made.
        """
        self._forked_pid = 0
        for _ in range(_STOPS_MAX):
            inside_pid = self.call(SYS_CLONE, flags, 0, 0, child_tid_address, 0)
            if inside_pid != _SIGNAL_CAME_FIRST:
                break
        if inside_pid < 0:
            raise OSError(-inside_pid, os.strerror(-inside_pid))
        child = self._forked_pid
        self._wait_for_stop(child)
        restart = self._waiting.copy()
        restart.rip -= len(_SYSCALL_INSTRUCTION)
        restart.rax = restart.orig_rax
        restart.orig_rax = _NO_SYSCALL
        self._set_registers(child, restart)
        self._request(_DETACH, 0, 0, pid=child)
        self._traced.discard(child)
        return child, inside_pid

    def end(self) -> None:
        """Kill the process and take its exit status: until its tracer has it, a traced process stays as a zombie."""
        for pid in tuple(self._traced):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
            with contextlib.suppress(TracedProcessGone):
                while True:
                    self._wait_for_stop(pid)

    def read_word(self, address: int) -> int:
        """Return eight bytes of its memory."""
        return self._peek(address)

    def write(self, address: int, data: bytes) -> None:
        """Write to its memory."""
        try:
            with open(f"/proc/{self.pid}/mem", "r+b", buffering=0) as memory:  # noqa: PTH123 - unbuffered, by address
                memory.seek(address)
                memory.write(data)
        except OSError as error:
            raise TracedProcessGone from error

    @property
    def scratch_address(self) -> int:
        """A place on its stack, below the red zone, that nothing uses."""
        return (int(self._waiting.rsp) - 1024) & ~15

    def _freeze_while_reading(self) -> _Registers:
        deadline = time.monotonic() + _FREEZE_DEADLINE_S
        pause_s, longest_pause_s = _FREEZE_PAUSES_S
        blocked_before: ctypes.c_uint64 | None = None
        while time.monotonic() < deadline:
            self._request(_INTERRUPT)
            self._wait_for_stop(self.pid)
            if blocked_before is None:
                blocked_before = self._block_signals()
            registers = self._registers(self.pid)
            if self._is_reading(registers):
                self._request(_SETSIGMASK, _SIGNAL_SET_BYTES, ctypes.addressof(blocked_before))
                return registers
            self._request(_CONT)
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, longest_pause_s)
        raise NotWaiting("the loaded policy did not wait for a question")

    def _block_signals(self) -> ctypes.c_uint64:
        """Block all signals of the stopped process; return those that were blocked before.

        A flood of them would stop it each time before it has run one instruction, so it would never reach its read.
        """
        before, every = ctypes.c_uint64(), ctypes.c_uint64(_ALL_SIGNALS)
        self._request(_GETSIGMASK, _SIGNAL_SET_BYTES, ctypes.addressof(before))
        self._request(_SETSIGMASK, _SIGNAL_SET_BYTES, ctypes.addressof(every))
        return before

    def _is_reading(self, registers: _Registers) -> bool:
        if registers.orig_rax not in _READING or ctypes.c_longlong(registers.rax).value not in _INTERRUPTED:
            return False
        return self._peek(registers.rip - 2).to_bytes(8, "little").startswith(_SYSCALL_INSTRUCTION)

    def _peek(self, address: int) -> int:
        """Return eight bytes of memory; works as well where the process has hidden its files in /proc."""
        ctypes.set_errno(0)
        word = _ptrace(_PEEKTEXT, self.pid, address, 0)
        if word == -1 and ctypes.get_errno() == _ESRCH:
            raise TracedProcessGone
        return int(word) & _NO_SYSCALL

    def _run_to_syscall_stop(self) -> None:
        for _ in range(_STOPS_MAX):
            self._request(_SYSCALL)
            status = self._wait_for_stop(self.pid)
            if os.WSTOPSIG(status) == _SYSCALL_STOP:
                return
            if status >> 16 in _EVENT_FORKS:
                message = ctypes.c_ulong()
                self._request(_GETEVENTMSG, 0, ctypes.addressof(message))
                self._forked_pid = message.value
                self._traced.add(message.value)
            # Every other stop is a signal that somebody sent; it is dropped by continuing without it.
        raise TracedProcessGone

    def _wait_for_stop(self, pid: int) -> int:
        try:
            _, status = os.waitpid(pid, _WAIT_ALL)
        except ChildProcessError as error:
            self._traced.discard(pid)
            raise TracedProcessGone from error
        if not os.WIFSTOPPED(status):
            self._traced.discard(pid)
            raise TracedProcessGone
        return status

    def _registers(self, pid: int) -> _Registers:
        registers = _Registers()
        self._request(_GETREGS, 0, ctypes.addressof(registers), pid=pid)
        return registers

    def _set_registers(self, pid: int, registers: _Registers) -> None:
        self._request(_SETREGS, 0, ctypes.addressof(registers), pid=pid)

    def _is_dead(self) -> bool:
        try:
            state = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            return True
        return state in {"Z", "X"}

    def _request(self, request: int, address: int = 0, data: int = 0, *, pid: int | None = None) -> None:
        if _ptrace(request, self.pid if pid is None else pid, address, data) != -1:
            return
        number = ctypes.get_errno()
        if number == _ESRCH or self._is_dead():  # a zombie is refused as if we had no right to trace it
            raise TracedProcessGone
        raise SandboxFailed(
            f"ptrace request {request} was refused ({os.strerror(number)}); allow the evaluator to trace its own "
            "children (in a container: add the capability SYS_PTRACE), or set VITAC_EPISODE_ISOLATION=fresh-process."
        )
