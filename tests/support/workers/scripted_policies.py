"""A policy in this process, in place of one in the sandbox: tests of trials say what it does."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from vitac.evaluator.agent.protocol import CloudSpec
from vitac.evaluator.agent.session import Isolation
from vitac.evaluator.episodes.episode import PlayingPolicy
from vitac.evaluator.episodes.records import Observation

Act = Callable[[Observation, int], NDArray[np.float32]]


class Scripted:
    """Acts as a function of the observation and its number says."""

    isolation: Isolation | None = None
    cpu_s = channel_s = 0.0
    answers_s = ()
    output = ""

    def __init__(self, act: Act, task: str = "peg-insertion", action_numbers: int = 3) -> None:
        self._act, self.seen = act, list[Observation]()
        self._asked = (task, (action_numbers,), ())

    def begin_shard(self) -> None:
        """Nothing is counted."""

    @contextmanager
    def episode(
        self, *, task: str, action_shape: tuple[int, ...], clouds: Sequence[CloudSpec] = ()
    ) -> Iterator[PlayingPolicy]:
        assert (task, action_shape, clouds) == self._asked
        yield self

    def act(self, observation: Observation) -> NDArray[np.float32]:
        self.seen.append(observation)
        return self._act(observation, len(self.seen))
