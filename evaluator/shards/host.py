"""The process that has the simulation loaded and forks a copy of itself for each shard; started by `process`.

Importing the environments and loading their kernels takes most of a second, which a new process per shard would spend
every time. Nothing of a shard remains here: it runs in the copy, which ends with it. Run as
`python -m vitac.evaluator.shards.host CONTROL`, where CONTROL is the descriptor of a socket. Each message on it carries
two descriptors: a socket for the order and its answers, and a pipe that gets the exit code.
"""

import ctypes
import os
import selectors
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

import numpy as np

from ..episodes.episode import make_environment
from ..sensors.check import design_in
from ..tracks import load_track
from ..version import evaluator_hash
from .execution import execute
from .order import PROCESS_ID, ShardOrder

_PR_SET_PDEATHSIG = 1
_DESCRIPTORS_PER_SHARD = 2


class SimulationHost:
    """Forks a process for each order that arrives on the control socket, until the other end closes it."""

    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._selector = selectors.DefaultSelector()
        self._selector.register(control, selectors.EVENT_READ)
        self._loaded: set[tuple[str, str, Path | None, Path | None]] = set()

    def serve(self) -> None:
        """Start shards and report their ends."""
        while True:
            for key, _ in self._selector.select():
                if key.fileobj is not self._control:
                    self._report_end(key)
                elif not self._start_shard():
                    return

    def _start_shard(self) -> bool:
        """Read one order and fork; False if the other end is gone."""
        _, descriptors, _, _ = socket.recv_fds(self._control, 1, _DESCRIPTORS_PER_SHARD)
        if len(descriptors) != _DESCRIPTORS_PER_SHARD:
            return False
        answers, exit_pipe = descriptors
        with socket.socket(fileno=answers) as connection:
            try:
                pid, pidfd = self._fork(connection)
            except (ValueError, OSError):
                # The order was cut off, or the machine is out of processes. The other end sees the socket close, and
                # the shards that run already go on.
                sys.excepthook(*sys.exc_info())
                os.close(exit_pipe)
                return True
        self._selector.register(pidfd, selectors.EVENT_READ, (pid, exit_pipe))
        return True

    def _fork(self, connection: socket.socket) -> tuple[int, int]:
        """Return process id and pidfd of the shard."""
        order = ShardOrder.model_validate_json(_read_all(connection))
        self._load(order)
        host_pid = os.getpid()
        pid = os.fork()
        if pid == 0:
            self._become_shard(host_pid, connection, order)
        try:
            return pid, os.pidfd_open(pid)
        except OSError:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            raise

    def _load(self, order: ShardOrder) -> None:
        """Play one env step of the order's task, so that its copies have all kernels and know the evaluator's hash."""
        what = (order.track, order.task, order.assets_dir, order.sensor)
        if what in self._loaded:
            return
        # The shard meets the same error and reports it with its result.
        with suppress(Exception):
            task = load_track(order.track).tasks[order.task]
            env = make_environment(task, order.assets_dir, sensor=design_in(order.sensor) if order.sensor else None)
            env.reset(options=task.episodes[0].options)
            env.step(np.zeros(len(task.actions), dtype=np.float32))
            evaluator_hash()
            self._loaded.add(what)

    def _become_shard(self, host_pid: int, connection: socket.socket, order: ShardOrder) -> NoReturn:
        """Run the shard in the forked process, which never returns."""
        exit_code = 1
        try:
            _die_with(host_pid)
            os.setsid()
            self._control.close()
            self._selector.close()
            socket.send_fds(connection, [PROCESS_ID.pack(os.getpid())], [os.pidfd_open(os.getpid())])
            with connection.makefile("w", encoding="utf-8") as answer:
                execute(order, answer)
            exit_code = 0
        except BaseException:  # noqa: BLE001 - the process ends here, and its parent sees the exit code
            sys.excepthook(*sys.exc_info())
        finally:
            os._exit(exit_code)

    def _report_end(self, key: selectors.SelectorKey) -> None:
        pid, exit_pipe = key.data
        self._selector.unregister(key.fileobj)
        os.close(key.fd)
        _, status = os.waitpid(pid, 0)
        with suppress(BrokenPipeError):
            os.write(exit_pipe, str(os.waitstatus_to_exitcode(status)).encode())
        os.close(exit_pipe)


def _read_all(connection: socket.socket) -> bytes:
    with connection.makefile("rb") as stream:
        return stream.read()


def _die_with(parent: int) -> None:
    """Ask the kernel to kill this process when its parent ends."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # It ended before the request.
        os._exit(1)


def main() -> None:
    """Serve until the process that started this one closes its end or dies."""
    # Whatever prints to stdout must not mix with the output of the process that started this one.
    os.dup2(2, 1)
    with socket.socket(fileno=int(sys.argv[1])) as control:
        SimulationHost(control).serve()


if __name__ == "__main__":
    main()
