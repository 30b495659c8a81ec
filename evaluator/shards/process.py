"""Runs shards in processes of their own and streams their records back; used by local evaluation and by the workers.

The simulation is heavy Python code: in the caller's process it would stop heartbeats and progress bars. One process,
`host`, has it loaded and forks a copy for each shard. A copy reads one order, writes one JSON line for each episode and
one for its end, and dies with its host, which ends when the process that started it closes the control socket or dies.
"""

import os
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from types import MappingProxyType, TracebackType
from typing import Self

from vitac.envs.errors import VitacError

from ..episodes.records import EpisodeRecord
from .order import PROCESS_ID, ShardMessage, ShardOrder
from .result import ShardResult

COMMAND = (sys.executable, "-P", "-m", "vitac.evaluator.shards.host")

_ONE_THREAD = MappingProxyType(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
)


class ShardProcessFailed(VitacError):
    """The process of a shard ended without a result: the machine, the sandbox or the simulation broke. Run it again."""


class ShardProcesses:
    """Starts processes of shards, any number at once, from any thread. Leaving the block ends all of them."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._host: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._lock:
            self._end_host()

    @contextmanager
    def running_shard(self, order: ShardOrder) -> Iterator["ShardProcess"]:
        """Run a shard in a process of its own, which has ended when the block is left.

        Raises:
            ShardProcessFailed: it cannot be started.
        """
        process = self._start(order)
        try:
            yield process
        finally:
            process.close()

    def _start(self, order: ShardOrder) -> "ShardProcess":
        with ExitStack() as theirs:
            ours, connection = socket.socketpair()
            exit_pipe, exit_end = os.pipe()
            theirs.callback(connection.close)
            theirs.callback(os.close, exit_end)
            with self._lock:
                control = self._running_host()
                try:
                    socket.send_fds(control, [b"\n"], [connection.fileno(), exit_end])
                except OSError as error:
                    raise ShardProcessFailed(f"A shard could not be started: {error.strerror}.") from error
        return ShardProcess(order, ours, exit_pipe)

    def _running_host(self) -> socket.socket:
        """Return the control socket of the host, which is started anew if it has ended."""
        if self._host is None or self._control is None or self._host.poll() is not None:
            self._end_host()
            self._control, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
            with theirs:
                self._host = subprocess.Popen(  # noqa: S603 - our own interpreter and module
                    [*COMMAND, str(theirs.fileno())],
                    stdin=subprocess.DEVNULL,
                    env=os.environ | _ONE_THREAD,
                    pass_fds=[theirs.fileno()],
                    start_new_session=True,
                )
        return self._control

    def _end_host(self) -> None:
        if self._control is not None:
            self._control.close()
        if self._host is not None:
            self._host.kill()
            self._host.wait()
        self._host = self._control = None


class ShardProcess:
    """A running shard; made by `ShardProcesses.running_shard`, which also ends it."""

    def __init__(self, order: ShardOrder, connection: socket.socket, exit_pipe: int) -> None:
        self._connection = connection
        self._exit_pipe = exit_pipe
        self._lock = threading.Lock()
        self._fork: _Fork | None = None
        self._is_killed = False
        self._result: ShardResult | None = None
        with suppress(BrokenPipeError):  # The host has ended; reading the records raises an error.
            connection.sendall(order.model_dump_json().encode())
            connection.shutdown(socket.SHUT_WR)

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
            code = os.read(self._exit_pipe, 16).decode() or "unknown"
            raise ShardProcessFailed(f"The process of a shard ended with exit code {code} and no result; run it again.")
        return self._result

    def records(self) -> Iterator[EpisodeRecord]:
        """Yield each record as soon as its episode is over; afterwards `result` is there.

        Raises:
            ShardProcessFailed: the process ended early.
        """
        self._forked()
        with self._connection.makefile("rb") as answers:
            for line in answers:
                message = ShardMessage.model_validate_json(line)
                if message.error is not None:
                    raise ShardProcessFailed(message.error)
                if message.record is not None:
                    yield message.record
                self._result = message.result
        _ = self.result

    def kill(self) -> None:
        """End the process, and with it its sandbox, at once; `records` then raises. Any thread may call it."""
        with self._lock:
            self._is_killed = True
            if self._fork is not None:
                self._fork.kill()
            else:
                # A process that is forked later finds nobody to answer to and ends.
                with suppress(OSError):
                    self._connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """End the process and wait for it."""
        self.kill()
        with suppress(ShardProcessFailed):
            fork = self._forked()
            fork.wait()
            with self._lock:
                fork.close()
        self._connection.close()
        os.close(self._exit_pipe)

    def _forked(self) -> "_Fork":
        """Return the process, which introduces itself before its first answer."""
        if self._fork is None:
            fork = _Fork.received(self._connection)
            with self._lock:
                self._fork = fork
                if self._is_killed:
                    fork.kill()
        return self._fork


class _Fork:
    """A process that the host has forked. Its descriptor, unlike its number, never means another process."""

    def __init__(self, pid: int, pidfd: int) -> None:
        self.pid = pid
        self._pidfd: int | None = pidfd

    @classmethod
    def received(cls, connection: socket.socket) -> Self:
        """Wait for the process to introduce itself.

        Raises:
            ShardProcessFailed: it never will.
        """
        introduction, descriptors, _, _ = socket.recv_fds(connection, PROCESS_ID.size, 1)
        if not descriptors:
            raise ShardProcessFailed("The process of a shard was not started; run it again.")
        (pid,) = PROCESS_ID.unpack(introduction)
        return cls(pid, descriptors[0])

    def kill(self) -> None:
        """End it at once, unless it has ended."""
        if self._pidfd is not None:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)

    def wait(self) -> None:
        """Return when it has ended."""
        if self._pidfd is not None:
            select.select([self._pidfd], [], [])

    def close(self) -> None:
        """Let go of a process that has ended."""
        if self._pidfd is not None:
            os.close(self._pidfd)
        self._pidfd = None
