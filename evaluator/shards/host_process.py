"""Starts the process that has the simulation loaded (`host`); light to import, so that it loads while its user does."""

import os
import socket
import subprocess
import sys
from types import MappingProxyType
from typing import Final, Self

from vitac.errors import VitacError, require_compilation

COMMAND = (sys.executable, "-P", "-m", "vitac.evaluator.shards.host")
CAN_FORK: Final = sys.platform == "linux"
"""Whether this system has what forks and watches the processes of shards; elsewhere `here` plays them."""
LOAD_ALL: Final = "load-all"
"""Argument of a host that loads the simulation of every task while it has nothing else to do."""
_ONE_THREAD = MappingProxyType(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
)


class ShardProcessFailed(VitacError):
    """The process of a shard ended without a result: the machine, the sandbox or the simulation broke. Run it again."""


class HostProcess:
    """A running `host` and the socket on which it gets orders; leaving its block ends it.

    Args:
        loads_all: whether it loads the simulation of every task while it waits for the first order.
    """

    def __init__(self, *, loads_all: bool = False) -> None:
        self.shards = 0
        """Number of shards that were ordered from it and have not been closed."""
        require_compilation()
        self._control, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
        with theirs:
            try:
                self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
                    [*COMMAND, str(theirs.fileno()), *([LOAD_ALL] if loads_all else [])],
                    stdin=subprocess.DEVNULL,
                    env=os.environ | _ONE_THREAD,
                    pass_fds=[theirs.fileno()],
                    start_new_session=True,
                )
            except OSError as error:
                self._control.close()
                raise ShardProcessFailed(f"The simulation could not be started: {error.strerror}.") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.end()

    def is_alive(self) -> bool:
        """Return whether it can still be asked."""
        return self._process.poll() is None

    def fork_shard(self) -> tuple[socket.socket, int]:
        """Have it fork the process of a shard; return the socket for its order and the pipe that gets its exit code.

        Raises:
            ShardProcessFailed: the host has ended.
        """
        connection, theirs = socket.socketpair()
        exit_pipe, exit_end = os.pipe()
        try:
            socket.send_fds(self._control, [b"\n"], [theirs.fileno(), exit_end])
        except OSError as error:
            connection.close()
            os.close(exit_pipe)
            raise ShardProcessFailed(f"A shard could not be started: {error.strerror}.") from error
        finally:
            theirs.close()
            os.close(exit_end)
        return connection, exit_pipe

    def end(self) -> None:
        """End it, and its shards with it."""
        self._control.close()
        self._process.kill()
        self._process.wait()
