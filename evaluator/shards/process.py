"""Runs a shard in a process of its own and streams its records back; used by local evaluation and by the workers.

The simulation is heavy Python code: in the caller's process it would stop heartbeats and progress bars. The child reads
one order from stdin and writes one JSON line for each episode and one for its end to stdout. It dies with its parent.
"""

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import IO, Self

from pydantic import NonNegativeInt, model_validator
from vitac.envs.errors import VitacError

from ..agent.limits import Limits
from ..episodes.records import EpisodeRecord, PolicyFailure
from ..strict_model import StrictModel
from ..tracks import Task, Track, load_track
from ..tracks.cut import Shard, cut
from .log import LogShard, resimulate_log
from .policy import run_shard
from .result import ShardResult
from .text_log import resimulate_text_log

_ONE_THREAD = MappingProxyType(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
)
_PR_SET_PDEATHSIG = 1


COMMAND = (sys.executable, "-P", "-m", "vitac.evaluator.shards.process")


class ShardProcessFailed(VitacError):
    """The process of a shard ended without a result: the machine, the sandbox or the simulation broke. Run it again."""


class ShardOrder(StrictModel):
    """What a shard process has to do: play a submission, or re-simulate an uploaded log."""

    submission_dir: Path | None = None
    log: Path | None = None
    text_log: Path | None = None
    track: str
    task: str
    shard: NonNegativeInt
    episodes: tuple[int, ...] | None = None
    slot: NonNegativeInt = 0
    limits: Limits = Limits()
    assets_dir: Path | None = None
    skip: tuple[int, ...] = ()
    earlier_failures: tuple[PolicyFailure, ...] = ()

    @model_validator(mode="after")
    def _names_one_source(self) -> Self:
        if sum(source is not None for source in (self.submission_dir, self.log, self.text_log)) != 1:
            raise ValueError("exactly one of submission_dir, log and text_log must be given")
        return self


class ShardMessage(StrictModel):
    """One line from a shard process: exactly one of its fields."""

    record: EpisodeRecord | None = None
    result: ShardResult | None = None
    error: str | None = None


class ShardProcess:
    """A running shard. Use `running_shard`, which also ends it."""

    def __init__(self, order: ShardOrder) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
            [*COMMAND, str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | _ONE_THREAD,
            start_new_session=True,
        )
        self._result: ShardResult | None = None
        stdin = _pipe(self._process.stdin)
        stdin.write(order.model_dump_json().encode())
        stdin.close()

    @property
    def pid(self) -> int:
        """Process id of the child."""
        return self._process.pid

    @property
    def result(self) -> ShardResult:
        """What the shard ended with; there once `records` has come to its end.

        Raises:
            ShardProcessFailed: there is none.
        """
        if self._result is None:
            code = self._process.wait()
            raise ShardProcessFailed(f"The process of a shard ended with exit code {code} and no result; run it again.")
        return self._result

    def records(self) -> Iterator[EpisodeRecord]:
        """Each record as soon as its episode is over; afterwards `result` is there.

        Raises:
            ShardProcessFailed: the process ended early.
        """
        for line in _pipe(self._process.stdout):
            message = ShardMessage.model_validate_json(line)
            if message.error is not None:
                raise ShardProcessFailed(message.error)
            if message.record is not None:
                yield message.record
            self._result = message.result
        _ = self.result

    def kill(self) -> None:
        """End the process, and with it its sandbox, at once; `records` then raises. Any thread may call it."""
        self._process.kill()

    def close(self) -> None:
        """End the process and wait for it."""
        self.kill()
        self._process.wait()
        _pipe(self._process.stdout).close()


@contextmanager
def running_shard(order: ShardOrder) -> Iterator[ShardProcess]:
    """Return a shard in a process of its own, which has ended when the block is left."""
    process = ShardProcess(order)
    try:
        yield process
    finally:
        process.close()


def _pipe(stream: IO[bytes] | None) -> IO[bytes]:
    if stream is None:
        raise ShardProcessFailed("The pipe to the process of the shard is missing.")
    return stream


def _die_with(parent: int) -> None:
    """Asks the kernel to kill this process when its parent ends."""
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # It ended before the request.
        os._exit(1)


def _run(order: ShardOrder, answer: IO[str]) -> None:
    def send(message: ShardMessage) -> None:
        answer.write(message.model_dump_json(exclude_unset=True) + "\n")
        answer.flush()

    try:
        result = _result_of(order, lambda record: send(ShardMessage(record=record)))
    except VitacError as error:
        send(ShardMessage(error=f"{type(error).__name__}: {error}"))
    else:
        send(ShardMessage(result=result))


def _result_of(order: ShardOrder, on_episode: Callable[[EpisodeRecord], None]) -> ShardResult:
    track = load_track(order.track)
    task = track.tasks[order.task]
    shard = next(shard for shard in cut(task, order.episodes) if shard.index == order.shard)
    if order.submission_dir is None:
        return _resimulate(order, track, task, shard, on_episode)
    return run_shard(
        submission_dir=order.submission_dir,
        track=track,
        task=task,
        shard=shard,
        on_episode=on_episode,
        limits=order.limits,
        slot=order.slot,
        assets_dir=order.assets_dir,
        skip=order.skip,
        earlier_failures=order.earlier_failures,
    )


def _resimulate(
    order: ShardOrder, track: Track, task: Task, shard: Shard, on_episode: Callable[[EpisodeRecord], None]
) -> ShardResult:
    log, resimulate = (order.log, resimulate_log) if order.log else (order.text_log, resimulate_text_log)
    assert log is not None  # noqa: S101 - the order names one source
    return resimulate(LogShard(log=log, track=track, task=task, shard=shard, skip=order.skip), on_episode)


def main() -> None:
    """Entry point of the child process; its argument is the parent's process id."""
    _die_with(int(sys.argv[1]))
    # Whatever prints to stdout must not mix with the answer: it goes to stderr.
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answer:
        os.dup2(2, 1)
        _run(ShardOrder.model_validate_json(sys.stdin.read()), answer)


if __name__ == "__main__":
    main()
