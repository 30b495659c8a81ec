import os
import signal
import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from subprocess import PIPE, Popen

import pytest
from vitac.evaluator.agent.isolation import tracing
from vitac.evaluator.agent.isolation.tracing import NotWaiting, TracedProcess, TracedProcessGone

pytestmark = pytest.mark.skipif(bool(tracing.explain_unsupported()), reason="only Linux on x86-64 is traced")
SYS_GETPID = 39
SYS_GETPPID = 110
WAITS = """
import os, signal, socket, sys
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGUSR2])
channel = socket.socket(fileno=int(sys.argv[1]))
channel.sendall(b"ready")
while True:
    question = channel.recv(100)
    channel.sendall(b"%d %s" % (os.getpid(), question))
"""


@dataclass(frozen=True)
class Waiting:
    process: "Popen[bytes]"
    channel: socket.socket


@pytest.fixture
def waiting() -> Iterator[Waiting]:
    ours, theirs = socket.socketpair()
    with ours:
        ours.settimeout(60)
        with theirs:
            process = Popen([sys.executable, "-c", WAITS, str(theirs.fileno())], pass_fds=[theirs.fileno()])
        assert ours.recv(5) == b"ready"
        yield Waiting(process, ours)
        process.kill()
        process.wait()


def test_runs_single_system_calls(waiting: Waiting) -> None:
    traced = TracedProcess(waiting.process.pid)
    assert traced.call(SYS_GETPID) == waiting.process.pid
    assert traced.call(SYS_GETPPID) == os.getpid()
    assert traced.call(tracing.SYS_KILL, -5, 0) < 0
    traced.end()


def blocked_signals(pid: int) -> set[int]:
    mask = int(Path(f"/proc/{pid}/status").read_text().split("SigBlk:")[1].split()[0], 16)
    return {number for number in range(1, 65) if mask >> (number - 1) & 1}


def test_the_frozen_process_and_its_copies_block_the_signals_that_it_blocked_before(waiting: Waiting) -> None:
    """While it is being frozen, all are blocked."""
    traced = TracedProcess(waiting.process.pid)
    outside, _ = traced.fork(signal.SIGCHLD, 0)
    for pid in (waiting.process.pid, outside):
        assert blocked_signals(pid) == {signal.SIGUSR2}
    os.kill(outside, signal.SIGKILL)
    traced.end()


def test_reads_back_what_it_writes(waiting: Waiting) -> None:
    traced = TracedProcess(waiting.process.pid)
    traced.write(traced.scratch_address, b"12345678")
    assert traced.read_word(traced.scratch_address) == int.from_bytes(b"12345678", "little")
    traced.end()


def test_copies_answer_and_the_frozen_process_does_not(waiting: Waiting) -> None:
    traced = TracedProcess(waiting.process.pid)
    for _ in range(3):
        outside, inside = traced.fork(signal.SIGCHLD, 0)
        assert outside == inside
        waiting.channel.sendall(b"question")
        assert waiting.channel.recv(100) == b"%d question" % outside
        os.kill(outside, signal.SIGKILL)
    traced.end()


def test_a_signal_in_the_middle_of_a_copy_does_not_hinder_it(waiting: Waiting, monkeypatch: pytest.MonkeyPatch) -> None:
    traced = TracedProcess(waiting.process.pid)
    run, signals = traced._run_to_syscall_stop, iter([signal.SIGUSR1])

    def run_and_signal() -> None:
        run()
        for number in signals:
            os.kill(waiting.process.pid, number)

    monkeypatch.setattr(traced, "_run_to_syscall_stop", run_and_signal)
    outside, _ = traced.fork(signal.SIGCHLD, 0)
    waiting.channel.sendall(b"question")
    assert waiting.channel.recv(100) == b"%d question" % outside
    os.kill(outside, signal.SIGKILL)
    traced.end()


def test_signals_do_not_wake_it(waiting: Waiting) -> None:
    traced = TracedProcess(waiting.process.pid)
    for number in (signal.SIGCONT, signal.SIGUSR1, signal.SIGSTOP, signal.SIGTERM, signal.SIGCONT):
        os.kill(waiting.process.pid, number)
        assert traced.call(SYS_GETPID) == waiting.process.pid
    traced.end()


def test_a_killed_process_is_noticed(waiting: Waiting) -> None:
    traced = TracedProcess(waiting.process.pid)
    os.kill(waiting.process.pid, signal.SIGKILL)
    with pytest.raises(TracedProcessGone):
        traced.call(SYS_GETPID)
    traced.end()


def test_a_process_that_never_waits_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracing, "_FREEZE_DEADLINE_S", 0.05)
    spins = "print(flush=True)\nwhile True: pass"
    with Popen([sys.executable, "-c", spins], stdout=PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        with pytest.raises(NotWaiting):
            TracedProcess(process.pid)


def test_a_process_that_is_not_there_is_noticed() -> None:
    process = Popen(["true"])
    process.wait()
    with pytest.raises(TracedProcessGone):
        TracedProcess(process.pid)


def test_nothing_stays_behind(waiting: Waiting) -> None:
    traced = TracedProcess(waiting.process.pid)
    traced.end()
    assert not Path(f"/proc/{waiting.process.pid}").exists()


def test_a_process_that_has_ended_and_was_not_waited_for_is_gone() -> None:
    with Popen(["true"]) as ended:
        os.waitid(os.P_PID, ended.pid, os.WEXITED | os.WNOWAIT)
        with pytest.raises(TracedProcessGone):
            TracedProcess(ended.pid)
