"""Shards in this process, one after the other, on systems without what forks and watches processes (`process`)."""

import io
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Self

from ..episodes.records import EpisodeRecord
from .execution import execute
from .host_process import ShardProcessFailed
from .order import OnCalibration, ShardMessage, ShardOrder, ShardResult
from .policy import Preparation


class ShardHere:
    """One shard; what is asked of it is what is asked of a `ShardProcess`."""

    result: ShardResult

    def __init__(self, order: ShardOrder, preparation: Preparation) -> None:
        self._order = order
        self._preparation = preparation

    def records(self, _: OnCalibration) -> Iterator[EpisodeRecord]:
        """Play all, then yield the records.

        Raises:
            ShardProcessFailed: the machine or the simulation broke.
        """
        answer = io.StringIO()
        execute(self._order, answer, self._preparation)
        for line in answer.getvalue().splitlines():
            message = ShardMessage.model_validate_json(line)
            if message.error is not None:
                raise ShardProcessFailed(message.error)
            if message.record is not None:
                yield message.record
            if message.result is not None:
                self.result = message.result

    def kill(self) -> None:
        """Let it end by itself: it is what this process does."""


class ShardsHere:
    """Stands in for `ShardProcesses`, with one shard at a time."""

    def __init__(self) -> None:
        self._exits = ExitStack()
        self._preparation = Preparation()

    def __enter__(self) -> Self:
        self._exits.enter_context(self._preparation)
        return self

    def __exit__(self, *exception: object) -> None:
        self._exits.close()

    @contextmanager
    def running_shard(self, order: ShardOrder) -> Iterator[ShardHere]:
        """Give a shard that is played when its records are read."""
        yield ShardHere(order, self._preparation)
