"""The process that has the simulation loaded and forks a copy of itself for a shard; started by `process`.

Importing the environments and loading their kernels takes most of a second, which a new process per shard would spend
every time. Nothing of a shard remains here: it runs in the copy, which ends with its submission. Run as
`python -m vitac.evaluator.shards.host CONTROL [load-all]`, where CONTROL is the descriptor of a socket. Each message on
it carries two descriptors: a socket for orders, one line each, and their answers, and a pipe that gets the exit code.
"""

import ctypes
import gc
import os
import select
import selectors
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

import numpy as np
from vitac.envs.maniskill.definition import is_maniskill

from ..episodes.episode import make_environment
from ..estimator.calibration import calibrated
from ..sensors.check import design_in
from ..tracks import Player
from ..tracks.registry import list_tracks, load_track
from ..version import evaluator_hash
from .execution import execute
from .order import LOAD_ALL, PROCESS_ID, ShardOrder
from .preparation import Preparation

_PR_SET_PDEATHSIG = 1
_DESCRIPTORS_PER_SHARD = 2


class SimulationHost:
    """Forks a process for each order that arrives on the control socket, until the other end closes it."""

    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._selector = selectors.DefaultSelector()
        self._selector.register(control, selectors.EVENT_READ)
        self._loaded: set[tuple[str, str, Path | None, Path | None]] = set()

    def load_all(self) -> None:
        """Load every task of every track, as long as no order waits."""
        for track in list_tracks():
            for task in load_track(track).tasks:
                if select.select([self._control], [], [], 0.0)[0]:
                    return
                self._load_task(track, task)

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
        order = ShardOrder.model_validate_json(_read_line(connection))
        self._load(order)
        gc.freeze()  # the copies' collections then leave the loaded modules alone, which they would copy otherwise
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
        self._load_task(order.track, order.task, order.assets_dir, order.sensor)

    def _load_task(self, track: str, task: str, assets_dir: Path | None = None, sensor: Path | None = None) -> None:
        """Play one env step of a task, so that copies have all kernels and know the evaluator's hash.

        For the standard estimator a sensor is calibrated here, once for all its shards.
        """
        what = (track, task, assets_dir, sensor)
        if what in self._loaded:
            return
        # The shard meets the same error and reports it with its result.
        with suppress(Exception):
            listed = load_track(track).tasks[task]
            if is_maniskill(listed.env_id):
                return  # ManiSkill starts threads, which a copy would not have: each shard loads it for itself.
            env = make_environment(listed, assets_dir, sensor=design_in(sensor) if sensor else None)
            env.reset(options=listed.episodes[0].options)
            env.step(np.zeros(len(listed.actions), dtype=np.float32))
            if sensor and listed.player is not Player.POLICY:
                calibrated(listed, sensor)
            evaluator_hash()
            self._loaded.add(what)

    def _become_shard(self, host_pid: int, connection: socket.socket, order: ShardOrder) -> NoReturn:
        """Run the shard, and those that are ordered after it, in the forked process, which never returns."""
        exit_code = 1
        try:
            _die_with(host_pid)
            os.setsid()
            self._control.close()
            self._selector.close()
            socket.send_fds(connection, [PROCESS_ID.pack(os.getpid())], [os.pidfd_open(os.getpid())])
            with connection.makefile("rw", encoding="utf-8") as stream, Preparation() as preparation:
                execute(order, stream, preparation)
                for line in stream:
                    execute(ShardOrder.model_validate_json(line), stream, preparation)
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


def _read_line(connection: socket.socket) -> bytes:
    """Return the first line; nothing follows it until it is answered."""
    line = b""
    while not line.endswith(b"\n"):
        piece = connection.recv(65536)
        if not piece:
            raise ValueError("Expected an order, got the end of the connection.")
        line += piece
    return line


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
        host = SimulationHost(control)
        if LOAD_ALL in sys.argv[2:]:
            host.load_all()
        host.serve()


if __name__ == "__main__":
    main()
