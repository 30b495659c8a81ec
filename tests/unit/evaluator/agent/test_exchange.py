"""evaluator/agent/exchange.py: which verdict explains a missing answer, with a sandbox that only pretends."""

import os
import signal
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import pytest
from vitac.evaluator.agent.exchange import LOADER_PID, Deadlines, EpisodeProcess, Exchange
from vitac.evaluator.agent.isolation.sandbox import Resources
from vitac.evaluator.agent.limits import MIB, Limits
from vitac.evaluator.agent.protocol import (
    AnswerHeader,
    AnswerKind,
    ChannelClosed,
    PolicyAnswer,
    PolicyQuestion,
    QuestionKind,
)
from vitac.evaluator.agent.verdicts import PolicyFailed, SandboxFailed, VerdictCode

PROCESS = EpisodeProcess(outside_pid=4711, inside_pid=7)
DEADLINES = Deadlines(what="act", wall_s=60.0, cpu_s=1.0)
LOADING = Deadlines(what="loading", wall_s=60.0, cpu_s=1.0, wall_verdict=VerdictCode.START_TIMEOUT)
KILLED = int(signal.SIGKILL)


def exited(code: int) -> int:
    return code << 8


@dataclass
class FakeChannel:
    """Gives the answers that it was given, then none; closed, it says so."""

    read: int
    answers: list[PolicyAnswer] = field(default_factory=list)
    is_closed: bool = False
    has_unsent: bool = False
    asked: list[PolicyQuestion] = field(default_factory=list)

    def fileno(self) -> int:
        return self.read

    def ask(self, question: PolicyQuestion) -> None:
        self.asked.append(question)

    def send_more(self) -> None:
        raise AssertionError("there is nothing to send")

    def receive(self, expected: Sequence[AnswerKind]) -> PolicyAnswer | None:
        if self.answers:
            return self.answers.pop(0)
        if self.is_closed:
            raise ChannelClosed("The policy closed the channel.")
        return None


@dataclass
class FakeOutput:
    """What the policy printed."""

    read: int
    counted_bytes: int = 0

    def fileno(self) -> int:
        return self.read

    def read_available(self) -> None:
        """Nothing more comes."""

    def text(self) -> str:
        return "printed before"


@dataclass
class FakeSandbox:
    """A sandbox whose processes end as the test says; counters change after the exchange has begun."""

    channel: FakeChannel
    output: FakeOutput
    status_descriptor: int
    statuses: dict[int, int] = field(default_factory=dict)
    is_gone: bool = False
    kills: int = 0
    refused: int = 0
    used_cpu_s: Iterator[float] = field(default_factory=lambda: iter([]))
    looks: int = 0

    def exit_status(self, pid: int) -> int | None:
        self.looks += 1
        return self.statuses.get(pid)

    def has_ended(self) -> bool:
        return self.is_gone

    def resources(self) -> Resources:
        return Resources(out_of_memory_kills=self.kills, refused_forks=self.refused)

    def cpu_s(self) -> float:
        return next(self.used_cpu_s, 0.0)


@pytest.fixture
def pipes() -> Iterator[list[tuple[int, int]]]:
    """Of channel, output and status: what is written makes them ready."""
    pipes = [os.pipe() for _ in range(3)]
    yield pipes
    for pair in pipes:
        for descriptor in pair:
            os.close(descriptor)


@pytest.fixture
def sandbox(pipes: list[tuple[int, int]]) -> FakeSandbox:
    channel, output, status = (read for read, _ in pipes)
    return FakeSandbox(FakeChannel(channel), FakeOutput(output), status)


def exchange_with(sandbox: FakeSandbox, process: EpisodeProcess | None = PROCESS) -> Exchange:
    return Exchange(sandbox, limits=Limits(output_killed_bytes=MIB), process=process)  # type: ignore[arg-type]


def an_answer(
    kind: AnswerKind, sender_pid: int = PROCESS.outside_pid, code: str = "", message: str = ""
) -> PolicyAnswer:
    return PolicyAnswer(
        header=AnswerHeader(seq=1, kind=kind, code=code, message=message), arrays={}, sender_pid=sender_pid
    )


def failure_of(exchange: Exchange, deadlines: Deadlines = DEADLINES) -> PolicyFailed:
    with pytest.raises(PolicyFailed) as caught:
        exchange.ask(PolicyQuestion(kind=QuestionKind.OBSERVE), AnswerKind.ACTION, deadlines)
    return caught.value


def test_the_answer_of_the_right_process_is_returned(sandbox: FakeSandbox) -> None:
    sandbox.channel.answers = [an_answer(AnswerKind.ACTION)]
    question = PolicyQuestion(kind=QuestionKind.OBSERVE)
    answer = exchange_with(sandbox).ask(question, AnswerKind.ACTION, DEADLINES)
    assert answer.header.kind is AnswerKind.ACTION
    assert sandbox.channel.asked == [question]


def test_an_answer_counts_though_its_process_has_ended_since(sandbox: FakeSandbox) -> None:
    sandbox.channel.answers = [an_answer(AnswerKind.ACTION)]
    sandbox.statuses = {PROCESS.inside_pid: exited(0)}
    assert exchange_with(sandbox).ask(PolicyQuestion(kind=QuestionKind.OBSERVE), AnswerKind.ACTION, DEADLINES)


@pytest.mark.parametrize(("is_reported", "looks"), [(False, 0), (True, 1)])
def test_ends_are_looked_up_for_an_answer_only_where_one_was_reported(
    sandbox: FakeSandbox, pipes: list[tuple[int, int]], is_reported: bool, looks: int
) -> None:
    (_, channel), _, (_, status) = pipes
    os.write(channel, b"answer")
    if is_reported:
        os.write(status, b"a child")
    sandbox.channel.answers = [an_answer(AnswerKind.ACTION)]
    exchange_with(sandbox).ask(PolicyQuestion(kind=QuestionKind.OBSERVE), AnswerKind.ACTION, DEADLINES)
    assert sandbox.looks == looks


def test_an_end_that_was_reported_before_the_question_is_found_without_a_further_report(
    sandbox: FakeSandbox, pipes: list[tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where half an answer keeps the channel busy: silence follows, and then it is looked up."""
    (read, channel), *_ = pipes
    os.write(channel, b"half")
    sandbox.statuses = {PROCESS.inside_pid: exited(4)}

    def receive(_: Sequence[AnswerKind]) -> None:
        if sandbox.looks == 0:
            os.read(read, 4)

    monkeypatch.setattr(sandbox.channel, "receive", receive)
    assert "exit code 4" in failure_of(exchange_with(sandbox)).message


def test_another_processs_answer_is_a_violation(sandbox: FakeSandbox) -> None:
    sandbox.channel.answers = [an_answer(AnswerKind.ACTION, sender_pid=12)]
    assert failure_of(exchange_with(sandbox)).verdict is VerdictCode.PROTOCOL_VIOLATION


@pytest.mark.parametrize(
    ("status", "verdict", "words"),
    [
        (exited(0), VerdictCode.CRASHED, "exit code 0 during act"),
        (exited(3), VerdictCode.CRASHED, "exit code 3 during act"),
        (KILLED, VerdictCode.CRASHED, r"signal 9 \(Killed\) during act"),
        (int(signal.SIGXCPU), VerdictCode.CPU_TIME, "used up its CPU time during act"),
    ],
)
def test_how_the_process_ended_is_told(sandbox: FakeSandbox, status: int, verdict: VerdictCode, words: str) -> None:
    sandbox.statuses = {PROCESS.inside_pid: status}
    failure = failure_of(exchange_with(sandbox))
    assert failure.verdict is verdict
    assert failure.output_tail == "printed before"
    with pytest.raises(PolicyFailed, match=words):
        raise failure


@pytest.mark.parametrize("status", [exited(0), exited(1), KILLED])
def test_a_loader_that_ended_is_the_policys_fault(sandbox: FakeSandbox, status: int) -> None:
    sandbox.statuses, sandbox.is_gone = {LOADER_PID: status}, True
    assert failure_of(exchange_with(sandbox, None), LOADING).verdict is VerdictCode.CRASHED


@pytest.mark.parametrize("process", [None, PROCESS])
def test_a_sandbox_that_is_gone_without_a_report_was_ended_from_outside(
    sandbox: FakeSandbox, process: EpisodeProcess | None
) -> None:
    sandbox.is_gone = True
    with pytest.raises(SandboxFailed, match="by something outside it"):
        exchange_with(sandbox, process).ask(PolicyQuestion(kind=QuestionKind.OBSERVE), AnswerKind.ACTION, DEADLINES)


@pytest.mark.parametrize("is_closed", [True, False])
def test_unless_all_processes_together_used_too_much_memory(sandbox: FakeSandbox, is_closed: bool) -> None:
    exchange = exchange_with(sandbox)
    sandbox.is_gone, sandbox.kills, sandbox.channel.is_closed = True, 1, is_closed
    assert failure_of(exchange).verdict is VerdictCode.OUT_OF_MEMORY


def test_a_closed_channel_is_explained_by_the_end_of_the_process(sandbox: FakeSandbox) -> None:
    sandbox.channel.is_closed = True
    sandbox.statuses = {PROCESS.inside_pid: exited(5)}
    assert "exit code 5" in failure_of(exchange_with(sandbox)).message


def test_silence_ends_at_the_deadline(sandbox: FakeSandbox) -> None:
    began = time.monotonic()
    assert failure_of(exchange_with(sandbox), replace(DEADLINES, wall_s=0.15)).verdict is VerdictCode.WALL_TIME
    assert time.monotonic() - began >= 0.15
    loading = failure_of(exchange_with(sandbox, None), replace(LOADING, wall_s=0.15))
    assert loading.verdict is VerdictCode.START_TIMEOUT


def test_cpu_time_is_counted_from_the_question(sandbox: FakeSandbox) -> None:
    sandbox.used_cpu_s = iter([5.0, 5.5, 6.5])
    failure = failure_of(exchange_with(sandbox))
    assert (failure.verdict, failure.message) == (
        VerdictCode.CPU_TIME,
        "More than 1 s of CPU time went into act.",
    )


def test_printing_too_much_ends_the_policy(sandbox: FakeSandbox) -> None:
    sandbox.output.counted_bytes = MIB + 1
    assert failure_of(exchange_with(sandbox)).verdict is VerdictCode.OUTPUT_FLOOD


def test_printing_too_much_before_an_answer_ends_the_policy_as_well(
    sandbox: FakeSandbox, pipes: list[tuple[int, int]]
) -> None:
    (_, channel), (_, output), _ = pipes
    os.write(output, b"flood")
    os.write(channel, b"answer")
    sandbox.channel.answers, sandbox.output.counted_bytes = [an_answer(AnswerKind.ACTION)], MIB + 1
    assert failure_of(exchange_with(sandbox)).verdict is VerdictCode.OUTPUT_FLOOD


def test_a_refused_fork_explains_what_followed_from_it(sandbox: FakeSandbox) -> None:
    exchange = exchange_with(sandbox)
    sandbox.refused, sandbox.statuses = 1, {PROCESS.inside_pid: exited(1)}
    failure = failure_of(exchange)
    assert failure.verdict is VerdictCode.TOO_MANY_PROCESSES
    assert "exit code 1" in failure.message


def test_what_was_refused_before_the_question_explains_nothing(sandbox: FakeSandbox) -> None:
    sandbox.refused, sandbox.kills, sandbox.statuses = 3, 2, {PROCESS.inside_pid: exited(1)}
    assert failure_of(exchange_with(sandbox)).verdict is VerdictCode.CRASHED


@pytest.mark.parametrize(
    ("code", "verdict"),
    [
        ("import_error", VerdictCode.IMPORT_ERROR),
        ("bad_action_shape", VerdictCode.BAD_ACTION_SHAPE),
        ("sandbox_failed", VerdictCode.PROTOCOL_VIOLATION),
        ("cpu_time", VerdictCode.PROTOCOL_VIOLATION),
        ("nothing of ours", VerdictCode.PROTOCOL_VIOLATION),
    ],
)
def test_the_runtime_may_report_some_verdicts_only(sandbox: FakeSandbox, code: str, verdict: VerdictCode) -> None:
    sandbox.channel.answers = [an_answer(AnswerKind.FAILED, code=code, message="because\x1b[31m")]
    failure = failure_of(exchange_with(sandbox))
    assert failure.verdict is verdict
    assert "\x1b" not in failure.message
