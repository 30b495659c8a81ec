"""Runs `making` in a process of its own, which can be ended at any time; called by the workers."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from pydantic import ValidationError
from vitac.errors import VitacError

from .making import PlaybackMessage, PlaybackOrder

COMMAND = (sys.executable, "-P", "-m", "vitac.evaluator.playback.making")


class PlaybackFailed(VitacError):
    """There is no playback of this episode, and trying again would not make one; the message says why."""


class MakingBroke(VitacError):
    """The process ended without an answer: it was ended, or the machine broke. Run it again."""


class MakingProcess:
    """A running process that makes a playback; see `making`."""

    def __init__(self, process: "subprocess.Popen[bytes]", order: PlaybackOrder) -> None:
        self._process = process
        self._order = order

    def played(self) -> Iterator[int]:
        """Yield the number of played env steps whenever it has grown; at the end, the files are in the order's folder.

        Raises:
            PlaybackFailed: the process says why there will be none.
            MakingBroke: it ended early.
        """
        assert self._process.stdin is not None  # noqa: S101 - both are pipes
        assert self._process.stdout is not None  # noqa: S101
        with suppress(BrokenPipeError), self._process.stdin as stream:
            stream.write(self._order.model_dump_json().encode())
        for line in self._process.stdout:
            message = _read(line)
            if message.error is not None:
                raise PlaybackFailed(message.error)
            if message.is_made:
                return
            if message.env_steps is not None:
                yield message.env_steps
        raise MakingBroke(f"The process of a playback ended with exit code {self._process.wait()} and no answer.")

    def kill(self) -> None:
        """End it at once; `played` then raises. Any thread may call it."""
        self._process.kill()


@contextmanager
def making(order: PlaybackOrder) -> Iterator[MakingProcess]:
    """Start the process of a playback, which has ended when the block is left.

    Raises:
        MakingBroke: it cannot be started.
    """
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    try:
        process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
            (*COMMAND, str(os.getpid())),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | threads,
            start_new_session=True,
        )
    except OSError as error:
        raise MakingBroke(f"The process of a playback could not be started: {error.strerror}.") from error
    with process:
        try:
            yield MakingProcess(process, order)
        finally:
            process.kill()


def _read(line: bytes) -> PlaybackMessage:
    try:
        return PlaybackMessage.model_validate_json(line)
    except ValidationError as error:  # It was killed in the middle of a line.
        raise MakingBroke("The process of a playback ended in the middle of an answer.") from error
