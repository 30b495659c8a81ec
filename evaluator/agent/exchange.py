"""One question and its one answer under deadlines, and the verdict where there is no answer."""

import os
import select
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import Final

from .isolation.output import printable
from .isolation.sandbox import Sandbox
from .limits import Limits
from .protocol import AnswerKind, ChannelClosed, PolicyAnswer, PolicyQuestion
from .verdicts import PolicyFailed, SandboxFailed, VerdictCode

LOADER_PID: Final = 2
"""Pid inside of the process that imports the policy."""
_TICK_S: Final = 0.05
"""How often limits are looked at while the policy thinks."""
_END_GRACE_S: Final = 2.0
_REPORTABLE: Final = frozenset(
    {
        VerdictCode.IMPORT_ERROR,
        VerdictCode.LOAD_FAILED,
        VerdictCode.CRASHED,
        VerdictCode.OUT_OF_MEMORY,
        VerdictCode.TOO_MANY_PROCESSES,
        VerdictCode.BAD_ACTION_TYPE,
        VerdictCode.BAD_ACTION_SHAPE,
    }
)
"""Verdicts that the runtime inside may name; the others are found from outside."""
_MAY_FOLLOW_FROM_REFUSED_FORKS: Final = frozenset(
    {
        VerdictCode.IMPORT_ERROR,
        VerdictCode.LOAD_FAILED,
        VerdictCode.CRASHED,
        VerdictCode.CPU_TIME,
        VerdictCode.WALL_TIME,
        VerdictCode.START_TIMEOUT,
    }
)


@dataclass(frozen=True, kw_only=True)
class Deadlines:
    """Limits on one answer."""

    what: str
    """What the policy does meanwhile, for the message."""
    wall_s: float
    cpu_s: float
    wall_verdict: VerdictCode = VerdictCode.WALL_TIME


@dataclass(frozen=True, kw_only=True)
class EpisodeProcess:
    """The process that plays one episode."""

    outside_pid: int
    inside_pid: int


class Exchange:
    """Questions to one process of a sandbox.

    Args:
        sandbox: where it runs.
        limits: what it may use.
        process: the episode's process; None while the policy is being loaded.
    """

    def __init__(self, sandbox: Sandbox, *, limits: Limits, process: EpisodeProcess | None) -> None:
        self._sandbox = sandbox
        self._limits = limits
        self._process = process
        self._before = sandbox.resources()
        self._poll = select.poll()
        for source in (sandbox.channel, sandbox.output, sandbox.status_descriptor):
            self._poll.register(source, select.POLLIN)

    def ask(self, question: PolicyQuestion, expected: AnswerKind, deadlines: Deadlines) -> PolicyAnswer:
        """Return the one answer to a question.

        Raises:
            PolicyFailed: any verdict.
            SandboxFailed: something outside has ended the sandbox.
        """
        try:
            self._sandbox.channel.ask(question)
            answer = self._wait((expected, AnswerKind.FAILED), deadlines)
        except PolicyFailed as failure:
            raise self.failure(failure.verdict, failure.message) from None
        if self._process is not None and answer.sender_pid != self._process.outside_pid:
            raise self.failure(
                VerdictCode.PROTOCOL_VIOLATION, "Received the answer from another process than the policy's."
            )
        if answer.header.kind is AnswerKind.FAILED:
            raise self._reported_failure(answer)
        return answer

    def failure(self, verdict: VerdictCode, message: str) -> PolicyFailed:
        """Return the verdict that explains a failure best: a limit that was hit goes before what followed from it."""
        now = self._sandbox.resources()
        if now.out_of_memory_kills > self._before.out_of_memory_kills:
            used = f"More than {self._limits.memory_bytes / 2**30:.3g} GiB of memory were used"
            verdict, message = VerdictCode.OUT_OF_MEMORY, f"{used}. ({message})"
        elif now.refused_forks > self._before.refused_forks and verdict in _MAY_FOLLOW_FROM_REFUSED_FORKS:
            verdict = VerdictCode.TOO_MANY_PROCESSES
            message = f"More than {self._limits.processes} processes and threads were started. ({message})"
        self._sandbox.output.read_available()
        return PolicyFailed(verdict, printable(message), self._sandbox.output.text())

    def _reported_failure(self, answer: PolicyAnswer) -> PolicyFailed:
        """Accept from the runtime inside only what it has to report, since the policy controls it."""
        code, message = answer.header.code, answer.header.message
        if code not in _REPORTABLE:
            return self.failure(VerdictCode.PROTOCOL_VIOLATION, f"The runtime reported the unknown verdict {code!r}.")
        return self.failure(VerdictCode(code), message)

    def _wait(self, expected: Sequence[AnswerKind], deadlines: Deadlines) -> PolicyAnswer:
        channel = self._sandbox.channel
        deadline = time.monotonic() + deadlines.wall_s
        cpu_before_s = self._sandbox.cpu_s()
        while True:
            self._poll.modify(channel, select.POLLIN | (select.POLLOUT if channel.has_unsent else 0))
            wait_ms = max(0.0, min(_TICK_S, deadline - time.monotonic())) * 1000
            ready = {descriptor for descriptor, _ in self._poll.poll(wait_ms)}
            if channel.has_unsent:
                channel.send_more()
            # Looked up first: whatever the process sent before it ended is in the socket by now. Nothing is looked at
            # for the usual answer that comes alone: what was printed before it would be there with it.
            may_have_ended = not ready or self._sandbox.status_descriptor in ready
            end = self._end() if may_have_ended else None
            answer = self._receive(expected)
            if answer is not None:
                if self._sandbox.output.fileno() in ready:
                    self._check_output()
                return answer
            self._check_output()
            if end is not None:
                raise _end_verdict(end, deadlines)
            self._check_memory()
            self._check_times(deadlines, deadline, cpu_before_s)

    def _receive(self, expected: Sequence[AnswerKind]) -> PolicyAnswer | None:
        try:
            return self._sandbox.channel.receive(expected)
        except ChannelClosed as closed:
            end = self._wait_for_end()
            if end is None:
                raise PolicyFailed(VerdictCode.PROTOCOL_VIOLATION, str(closed)) from None
            raise _end_verdict(end, None) from None

    def _check_output(self) -> None:
        self._sandbox.output.read_available()
        if self._sandbox.output.counted_bytes > self._limits.output_killed_bytes:
            message = f"More than {self._limits.output_killed_bytes} bytes were printed."
            raise PolicyFailed(VerdictCode.OUTPUT_FLOOD, message)

    def _check_memory(self) -> None:
        if self._sandbox.resources().out_of_memory_kills > self._before.out_of_memory_kills:
            raise PolicyFailed(VerdictCode.OUT_OF_MEMORY, "A process was ended.")

    def _check_times(self, deadlines: Deadlines, deadline: float, cpu_before_s: float) -> None:
        if self._sandbox.cpu_s() - cpu_before_s > deadlines.cpu_s:
            message = f"More than {deadlines.cpu_s:g} s of CPU time went into {deadlines.what}."
            raise PolicyFailed(VerdictCode.CPU_TIME, message)
        if time.monotonic() > deadline:
            message = f"{deadlines.what} took more than {deadlines.wall_s:g} s."
            raise PolicyFailed(deadlines.wall_verdict, message)

    def _end(self) -> int | None:
        """Return how the process that should answer has ended, None while it can still answer."""
        if self._process is not None:
            status = self._sandbox.exit_status(self._process.inside_pid)
        else:
            status = self._sandbox.exit_status(LOADER_PID) or None
        if status is None and self._sandbox.has_ended():
            status = self._sandbox.exit_status(LOADER_PID)
            if status is None:
                raise self._end_from_outside()
        return status

    def _end_from_outside(self) -> PolicyFailed | SandboxFailed:
        """Explain a sandbox that is gone though its first process never reported how the policy's did.

        The policy cannot end that process, unless all of them together use too much memory.
        """
        if self._sandbox.resources().out_of_memory_kills > self._before.out_of_memory_kills:
            return PolicyFailed(VerdictCode.OUT_OF_MEMORY, "All processes were ended.")
        return SandboxFailed("The sandbox was ended by something outside it, not by the policy.")

    def _wait_for_end(self) -> int | None:
        deadline = time.monotonic() + _END_GRACE_S
        while (end := self._end()) is None and time.monotonic() < deadline:
            wait([self._sandbox.status_descriptor], 0.01)
        return end


def _end_verdict(status: int, deadlines: Deadlines | None) -> PolicyFailed:
    during = f" during {deadlines.what}" if deadlines is not None else ""
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        if number == signal.SIGXCPU:
            return PolicyFailed(VerdictCode.CPU_TIME, f"The policy's process used up its CPU time{during}.")
        name = signal.strsignal(number) or "unknown"
        return PolicyFailed(VerdictCode.CRASHED, f"The policy's process was ended by signal {number} ({name}){during}.")
    code = os.WEXITSTATUS(status)
    return PolicyFailed(VerdictCode.CRASHED, f"The policy's process ended with exit code {code}{during}.")
