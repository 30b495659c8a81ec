"""Runs shards in processes of their own and streams their records back; used by local evaluation and by the workers.

The simulation is heavy Python code: in the caller's process it would stop heartbeats and progress bars. One process,
`host`, has it loaded and forks a copy for a shard. A copy reads an order, writes one JSON line for each episode and one
for its end, and waits a moment for the next order of the same submission, whose policy it has loaded. It dies with its
host, which ends when the process that started it closes the control socket or dies.
"""

import os
import select
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import BinaryIO, Self

from pydantic import ValidationError

from ..episodes.records import EpisodeRecord
from .host_process import HostProcess, ShardProcessFailed
from .order import PROCESS_ID, OnCalibration, ShardMessage, ShardOrder, ShardResult, decode_waiting

IDLE_KEPT_S = 3.0
"""How long a process waits for another shard of its submission; meanwhile its policy takes memory."""
CLOSING_LIMIT_S = 5.0
"""A process that does not end by itself within this time is killed."""


class ShardProcesses:
    """Starts processes of shards, any number at once, from any thread. Leaving the block ends all of them.

    Args:
        host: forks the first ones; one is started where it is None.
    """

    def __init__(self, host: HostProcess | None = None) -> None:
        self._lock = threading.Lock()
        self._newest = host
        self._hosts = {host} if host else set()
        self._idle: dict[ShardProcess, threading.Timer] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._close_idle(list(self._idle))
        with self._lock:
            for host in self._hosts:
                host.end()

    def prepare(self) -> None:
        """Start to load the simulation of every task, so that no shard has to wait for it.

        Raises:
            ShardProcessFailed: it cannot be started.
        """
        with self._lock:
            if self._newest is None:
                self._newest = HostProcess(loads_all=True)
                self._hosts.add(self._newest)

    @contextmanager
    def running_shard(self, order: ShardOrder) -> Iterator["ShardProcess"]:
        """Run a shard in a process of its own, or in one that has ended another shard with the same loaded policy.

        When the block is left the shard is over; the process has ended, or waits for another shard.

        Raises:
            ShardProcessFailed: it cannot be started.
        """
        process = self._take_idle(order) or self._start(order)
        try:
            yield process
        finally:
            if process.release():
                self._keep(process)
            else:
                self._end(process)

    def _start(self, order: ShardOrder) -> "ShardProcess":
        host = self._join_host()
        try:
            return ShardProcess(host, order, *host.fork_shard())
        except BaseException:
            self._leave_host(host, is_working=False)
            raise

    def _end(self, process: "ShardProcess") -> None:
        self._leave_host(process.host, is_working=process.close())

    def _take_idle(self, order: ShardOrder) -> "ShardProcess | None":
        """Return an idle process that has the order's policy loaded, at work on it; end the others, they only wait."""
        with self._lock:
            waiting = list(self._idle)
        fitting = [process for process in waiting if process.order.preparation() == order.preparation()]
        self._close_idle([process for process in waiting if process not in fitting])
        for process in fitting:
            if self._is_taken(process):
                if not process.has_ended():
                    return process.take_order(order)
                self._end(process)
        return None

    def _keep(self, process: "ShardProcess") -> None:
        timer = threading.Timer(IDLE_KEPT_S, self._close_idle, args=([process],))
        timer.daemon = True
        with self._lock:
            self._idle[process] = timer
        timer.start()

    def _close_idle(self, processes: "list[ShardProcess]") -> None:
        taken = [process for process in processes if self._is_taken(process)]
        for process in taken:
            process.let_end()
        for process in taken:
            self._end(process)

    def _is_taken(self, process: "ShardProcess") -> bool:
        """Take a process out of the idle ones; False if somebody else has."""
        with self._lock:
            timer = self._idle.pop(process, None)
        if timer is not None:
            timer.cancel()
        return timer is not None

    def _join_host(self) -> HostProcess:
        """Return the newest host, or a new one if there is none that works."""
        with self._lock:
            if self._newest is None or not self._newest.is_alive():
                self._newest = HostProcess()
                self._hosts.add(self._newest)
            self._newest.shards += 1
            return self._newest

    def _leave_host(self, host: HostProcess, *, is_working: bool) -> None:
        """Use another host from now on if this one did not fork; end it when its last shard has ended."""
        with self._lock:
            host.shards -= 1
            if not is_working and host is self._newest:
                self._newest = None
            if host is not self._newest and host.shards == 0:
                host.end()
                self._hosts.discard(host)


class ShardProcess:
    """A running shard; made by `ShardProcesses.running_shard`, which also ends it.

    Attributes:
        host: what forks its process.
        order: what it has to do.
        packages: versions of the packages that its policy sees, by name; known before the first record. None where no
            policy runs.
        video: of none of its episodes; trials on stations have one.
        awaits_person: never; operators of stations are asked.
    """

    video = None
    awaits_person = False

    def __init__(
        self,
        host: HostProcess,
        order: ShardOrder,
        connection: socket.socket,
        exit_pipe: int,
        fork: "_Fork | None" = None,
    ) -> None:
        self.host = host
        self.order = order
        self._connection = connection
        self._exit_pipe = exit_pipe
        self._lock = threading.Lock()
        self._fork = fork
        self._is_killed = False
        self._is_taken = fork is not None
        self._is_released = False
        self.packages: dict[str, str] | None = None
        self._result: ShardResult | None = None
        with suppress(OSError):  # The process has ended; reading the records raises an error.
            connection.sendall(order.model_dump_json().encode() + b"\n")

    @property
    def pid(self) -> int:
        """Process id of the shard; waits until it has been forked."""
        return self._forked().pid

    @property
    def result(self) -> ShardResult:
        """What the shard ended with; there once `records` has come to its end.

        Raises:
            ShardProcessFailed: there is none.
        """
        if self._result is None:
            code = self._exit_code()
            raise ShardProcessFailed(f"The process of a shard ended with exit code {code} and no result; run it again.")
        return self._result

    def records(self, on_calibration: OnCalibration = lambda *_: None) -> Iterator[EpisodeRecord]:
        """Yield each record as soon as its episode is over; afterwards `result` is there.

        Args:
            on_calibration: gets how far the calibration of its sensor is, while the shard waits for it.

        Raises:
            ShardProcessFailed: the process ended early.
        """
        self._forked(on_calibration)
        try:
            with self._connection.makefile("rb") as answers:
                yield from self._read_records(answers)
        except (OSError, ValidationError) as error:  # It was killed, perhaps in the middle of a line.
            raise ShardProcessFailed(f"The process of a shard ended with exit code {self._exit_code()}.") from error
        _ = self.result

    def kill(self) -> None:
        """End the process, and with it its sandbox, at once; `records` then raises. Any thread may call it."""
        with self._lock:
            if self._is_released:
                return
            self._is_killed = True
            if self._fork is not None:
                self._fork.kill()
            else:
                # A process that is forked later cannot answer and ends.
                with suppress(OSError):
                    self._connection.shutdown(socket.SHUT_RDWR)

    def release(self) -> bool:
        """Give up the right to kill the process if it has done its order; return whether it can do another one."""
        with self._lock:
            self._is_released = self._result is not None and not self._is_killed
            return self._is_released

    def has_ended(self) -> bool:
        """Return whether the process has ended, though nobody asked it to; waits until it has been forked."""
        return self._forked().wait(0.0)

    def take_order(self, order: ShardOrder) -> "ShardProcess":
        """Give the process another order; what runs it is returned, and this object has nothing more to do with it."""
        return ShardProcess(self.host, order, self._connection, self._exit_pipe, self._fork)

    def let_end(self) -> None:
        """Let the process end if it waits for another order, without waiting for that: many end at the same time."""
        with suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> bool:
        """End the process and wait for it; return whether its host ever answered.

        One that waits for another order ends by itself and clears up; one at work is killed.
        """
        self.kill()
        try:
            fork = self._forked()
        except ShardProcessFailed:
            return self._is_taken
        else:
            self.let_end()
            if not fork.wait(CLOSING_LIMIT_S):
                fork.kill()
                fork.wait()
            with self._lock:
                fork.close()
            return True
        finally:
            self._connection.close()
            os.close(self._exit_pipe)

    def _read_records(self, answers: BinaryIO) -> Iterator[EpisodeRecord]:
        for line in answers:
            message = ShardMessage.model_validate_json(line)
            if message.error is not None:
                raise ShardProcessFailed(message.error)
            if message.packages is not None:
                self.packages = message.packages
            if message.record is not None:
                yield message.record
            if message.result is not None:
                self._result = message.result
                return

    def _exit_code(self) -> str:
        """Wait for the end of the process and return its exit code, `unknown` where the host ended as well."""
        return os.read(self._exit_pipe, 16).decode() or "unknown"

    def _forked(self, on_calibration: OnCalibration = lambda *_: None) -> "_Fork":
        """Return the process, which introduces itself before its first answer."""
        while self._fork is None:
            received = _Fork.receive(self._connection)
            self._is_taken = True
            if isinstance(received, tuple):  # The host lets it wait; the first of those that wait gets how far it is.
                if received[0]:
                    on_calibration(*received)
                continue
            with self._lock:
                self._fork = fork = received
                if self._is_killed:
                    fork.kill()
        return self._fork


class _Fork:
    """A process that the host has forked. Its descriptor, unlike its number, never means another process."""

    def __init__(self, pid: int, pidfd: int) -> None:
        self.pid = pid
        self._pidfd: int | None = pidfd

    @classmethod
    def receive(cls, connection: socket.socket) -> Self | tuple[int, int]:
        """Wait for the process to introduce itself; where it waits, return how far its sensor's calibration is.

        Raises:
            ShardProcessFailed: it never will.
        """
        try:
            introduction, descriptors, _, _ = socket.recv_fds(connection, PROCESS_ID.size, 1)
        except OSError as error:
            raise ShardProcessFailed(
                f"The process of a shard was not started: {error.strerror}; run it again."
            ) from error
        if len(introduction) < PROCESS_ID.size:
            raise ShardProcessFailed("The process of a shard was not started; run it again.")
        if not descriptors:
            return decode_waiting(introduction)
        (pid,) = PROCESS_ID.unpack(introduction)
        return cls(pid, descriptors[0])

    def kill(self) -> None:
        """End it at once, unless it has ended."""
        if self._pidfd is not None:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)

    def wait(self, limit_s: float | None = None) -> bool:
        """Wait until it has ended, at most this time [s]; return whether it has."""
        if self._pidfd is None:
            return True
        ended = select.poll()
        ended.register(self._pidfd, select.POLLIN)
        return bool(ended.poll(None if limit_s is None else 1000 * limit_s))

    def close(self) -> None:
        """Close the descriptor of a process that has ended."""
        if self._pidfd is not None:
            os.close(self._pidfd)
        self._pidfd = None
