"""The process that has the simulation loaded and forks a copy of itself for a shard; started by `process`.

Importing the environments and loading their kernels takes most of a second, which a new process per shard would spend
every time. Nothing of a shard remains here: it runs in the copy, which ends with its submission. Run as
`python -m vitac.evaluator.shards.host CONTROL [load-all]`, where CONTROL is the descriptor of a socket. Each message on
it carries two descriptors: a socket for orders, one line each, and their answers, and a pipe that gets the exit code.

A sensor is calibrated in a copy of its own, which takes half a minute; meanwhile other orders are carried out.
"""

import gc
import logging
import os
import selectors
import signal
import socket
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial
from multiprocessing.connection import wait
from pathlib import Path
from typing import NoReturn

import numpy as np
from vitac.envs.kernel_cache import STARTED_LOG
from vitac.envs.maniskill.definition import is_maniskill
from vitac.errors import VitacError

from ..agent.isolation.packages import installed_packages
from ..episodes.episode import make_environment
from ..estimator import STARTS, calibrated, is_calibrated, take
from ..parent_death import end_with_parent
from ..regression import Coefficients
from ..sensors.made import read_design
from ..tracks import Player, Task
from ..tracks.registry import compute_hash, list_parts, list_tracks, load_track
from .execution import execute
from .host_process import LOAD_ALL
from .order import PROCESS_ID, ShardOrder, encode_waiting
from .policy import Preparation

_DESCRIPTORS_PER_SHARD = 2
_OPTIONAL_IN_NUMBA = ("cffi", "scipy")


@dataclass(frozen=True, kw_only=True)
class _Ordered:
    """An order whose shard is not forked yet, and the descriptors that were sent with it."""

    order: ShardOrder
    connection: socket.socket
    exit_pipe: int

    def close(self) -> None:
        """Close the descriptors; the other end then sees that no process will answer."""
        self.connection.close()
        os.close(self.exit_pipe)


@dataclass(frozen=True, kw_only=True)
class _Calibration:
    """A calibration at work: the memory file that gets the coefficients, and the orders that wait for them."""

    task: Task
    sensor: Path
    memory: int
    waiting: list[_Ordered] = field(default_factory=list)


class SimulationHost:
    """Forks a process for each order that arrives on the control socket, until the other end closes it."""

    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._selector = selectors.DefaultSelector()
        self._selector.register(control, selectors.EVENT_READ)
        self._loaded: set[tuple[str, str, Path | None, Path | None]] = set()
        self._calibrations: dict[tuple[str, Path], _Calibration] = {}
        """Running and failed calibrations; shards of a failed one calibrate for themselves, and report the error."""

    def load_all(self) -> None:
        """Load every task of every track, as long as no order waits."""
        for track in list_tracks():
            for task in load_track(track).tasks:
                if wait([self._control], 0.0):
                    return
                self._load_task(track, task)

    def serve(self) -> None:
        """Start shards and report their ends."""
        while True:
            for key, _ in self._selector.select():
                if key.fileobj is not self._control:
                    self._reap(key)
                elif not self._take_order():
                    return

    def _take_order(self) -> bool:
        """Read one order and fork, or let it wait for a calibration; False if the other end is gone."""
        _, descriptors, _, _ = socket.recv_fds(self._control, 1, _DESCRIPTORS_PER_SHARD)
        if len(descriptors) != _DESCRIPTORS_PER_SHARD:
            return False
        answers, exit_pipe = descriptors
        connection = socket.socket(fileno=answers)
        try:
            order = ShardOrder.model_validate_json(_read_line(connection))
        except (ValueError, OSError):  # The order was cut off. The shards that run already continue.
            sys.excepthook(*sys.exc_info())
            connection.close()
            os.close(exit_pipe)
            return True
        self._load_task(order.track, order.task, order.assets_dir, order.sensor)
        ordered = _Ordered(order=order, connection=connection, exit_pipe=exit_pipe)
        if self._waits_for_calibration(ordered):
            with suppress(OSError):  # It was given up meanwhile; its copy will find nobody to answer.
                connection.sendall(encode_waiting(0, STARTS))
        else:
            self._start_shard(ordered)
        return True

    def _start_shard(self, ordered: _Ordered) -> None:
        started = self._fork(partial(self._be_shard, ordered), partial(_report_end, ordered.exit_pipe))
        ordered.connection.close()
        if not started:
            os.close(ordered.exit_pipe)

    def _waits_for_calibration(self, ordered: _Ordered) -> bool:
        """Have the order of the standard estimator wait for the coefficients of its sensor; False if it need not."""
        sensor, task = ordered.order.sensor, _known_task(ordered.order)
        if sensor is None or task is None or task.player is Player.POLICY:
            return False
        if ordered.order.coefficients is not None or is_calibrated(task, sensor):
            return False
        key = (task.env_id, sensor)
        if key not in self._calibrations:
            calibration = _Calibration(task=task, sensor=sensor, memory=os.memfd_create("coefficients"))
            self._calibrations[key] = calibration
            calibration.waiting.append(ordered)
            with ordered.connection.dup() as answers:  # a copy closes those of all that wait
                if not self._fork(
                    partial(_calibrate, calibration, answers), partial(self._end_calibration, calibration)
                ):
                    os.close(calibration.memory)
                    calibration.waiting.clear()
        elif self._calibrations[key].waiting:
            self._calibrations[key].waiting.append(ordered)
        return bool(self._calibrations[key].waiting)

    def _end_calibration(self, ended: _Calibration, exit_code: int) -> None:
        """Take the coefficients, and fork the shards that waited for them."""
        with open(ended.memory, "rb") as memory:  # noqa: PTH123 - a descriptor
            memory.seek(0)  # the copy has left it at the end
            content = memory.read()
        if exit_code == 0:
            take(ended.task, ended.sensor, Coefficients.model_validate_json(content))
        while ended.waiting:  # one after the other: each copy closes the descriptors of those that wait still
            self._start_shard(ended.waiting.pop(0))
        if exit_code == 0:
            del self._calibrations[ended.task.env_id, ended.sensor]

    def _fork(self, work: Callable[[], None], ended: Callable[[int], None]) -> bool:
        """Do work in a copy of this process; `ended` gets its exit code. False where there is no process left."""
        gc.freeze()  # the copies' collections then leave the loaded modules alone, which they would copy otherwise
        host_pid = os.getpid()
        try:
            pid = os.fork()
            if pid == 0:
                self._become_copy(host_pid, work)
            pidfd = _opened(pid)
        except OSError:  # The other end sees the socket close, and the shards that run already continue.
            sys.excepthook(*sys.exc_info())
            return False
        self._selector.register(pidfd, selectors.EVENT_READ, (pid, ended))
        return True

    def _load_task(self, track: str, task: str, assets_dir: Path | None = None, sensor: Path | None = None) -> None:
        """Play one env step of a task, so that copies have its kernels and parts, and know hashes and packages."""
        what = (track, task, assets_dir, sensor)
        if what in self._loaded:
            return
        # The shard meets the same error and reports it with its result.
        with suppress(Exception):
            loaded = load_track(track)
            listed = loaded.tasks[task]
            if is_maniskill(listed.env_id):
                return  # ManiSkill starts threads, which a copy would not have: each shard loads it for itself.
            _load_numba()
            env = make_environment(listed, assets_dir, sensor=read_design(sensor) if sensor else None)
            env.reset(options=listed.episodes[0].options)
            env.step(np.zeros(len(listed.actions), dtype=np.float32))
            env.mesh_hash()  # which needs the parts of every shape
            compute_hash(track)
            list_parts(track)
            installed_packages(loaded.packages)
            self._loaded.add(what)

    def _become_copy(self, host_pid: int, work: Callable[[], None]) -> NoReturn:
        """Do work in the forked process, which never returns."""
        exit_code = 1
        try:
            end_with_parent(host_pid)
            os.setsid()
            gc.enable()
            self._control.close()
            self._selector.close()
            for calibration in self._calibrations.values():
                for ordered in calibration.waiting:  # else the other end would not see the end of its own process
                    ordered.close()
            work()
            exit_code = 0
        except BaseException:  # noqa: BLE001 - the process ends here, and its parent sees the exit code
            sys.excepthook(*sys.exc_info())
        finally:
            os._exit(exit_code)

    def _be_shard(self, ordered: _Ordered) -> None:
        """Run the shard, and those that are ordered after it."""
        connection = ordered.connection
        socket.send_fds(connection, [PROCESS_ID.pack(os.getpid())], [os.pidfd_open(os.getpid())])
        with connection.makefile("rw", encoding="utf-8") as stream, Preparation() as preparation:
            execute(ordered.order, stream, preparation)
            for line in stream:
                execute(ShardOrder.model_validate_json(line), stream, preparation)

    def _reap(self, key: selectors.SelectorKey) -> None:
        """Collect a copy that has ended."""
        pid, ended = key.data
        self._selector.unregister(key.fileobj)
        os.close(key.fd)
        _, status = os.waitpid(pid, 0)
        ended(os.waitstatus_to_exitcode(status))


@cache
def _load_numba() -> None:
    """Load Numba as if what no kernel of ours uses were not installed: it takes a fifth of the time to load."""
    loaded = {name: sys.modules[name] for name in _OPTIONAL_IN_NUMBA if name in sys.modules}
    sys.modules.update(dict.fromkeys(_OPTIONAL_IN_NUMBA))  # type: ignore[arg-type] # None: there is no such module
    try:
        import numba.core.typing.cffi_utils
        import numba.np.arraymath  # noqa: F401 - these two would load it
    finally:
        for name in _OPTIONAL_IN_NUMBA:
            del sys.modules[name]
        sys.modules.update(loaded)


def _known_task(order: ShardOrder) -> Task | None:
    """Return the task of an order; None where there is none, which the shard reports."""
    with suppress(VitacError):
        return load_track(order.track).tasks.get(order.task)
    return None


def _calibrate(calibration: _Calibration, answers: socket.socket) -> None:
    """Calibrate in a copy of the host; the other end of the first order that waits gets how far it is."""

    def report(played: int, starts: int) -> None:
        with suppress(OSError):  # it was given up meanwhile; others may wait
            answers.sendall(encode_waiting(played, starts))

    coefficients = calibrated(calibration.task, calibration.sensor, report)
    with open(calibration.memory, "wb") as memory:  # noqa: PTH123 - a descriptor
        memory.write(coefficients.as_bytes())


def _report_end(exit_pipe: int, exit_code: int) -> None:
    with suppress(BrokenPipeError):
        os.write(exit_pipe, str(exit_code).encode())
    os.close(exit_pipe)


def _opened(pid: int) -> int:
    """Return the pidfd of a copy; without one it is ended."""
    try:
        return os.pidfd_open(pid)
    except OSError:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        raise


def _read_line(connection: socket.socket) -> bytes:
    """Return the first line; nothing follows it until it is answered."""
    line = b""
    while not line.endswith(b"\n"):
        piece = connection.recv(65536)
        if not piece:
            raise ValueError("Expected an order, got the end of the connection.")
        line += piece
    return line


def main() -> None:
    """Serve until the process that started this one closes its end or dies."""
    # Whatever prints to stdout must not mix with the output of the process that started this one.
    os.dup2(2, 1)
    logging.getLogger(STARTED_LOG).disabled = True  # commands show how far it is themselves
    gc.disable()  # what is loaded stays, and looking through it takes a fifth of the time
    with socket.socket(fileno=int(sys.argv[1])) as control:
        host = SimulationHost(control)
        if LOAD_ALL in sys.argv[2:]:
            host.load_all()
        host.serve()


if __name__ == "__main__":
    main()
