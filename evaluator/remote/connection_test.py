"""Asks a policy server one blank observation of each task; called at an upload, before anything is queued."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..agent.limits import Limits
from ..tracks import Task
from .description import RemoteServer
from .session import RemoteSession


@dataclass(frozen=True, kw_only=True)
class BlankAnswer:
    """How a policy server answered a blank observation of a task.

    Attributes:
        task: its name.
        answer_s: from the question to the answer [s].
        low: smallest number of the action; what is beyond [-1, 1] is clipped.
        high: largest one.
    """

    task: str
    answer_s: float
    low: float
    high: float


def test_connection(
    address: str, server: RemoteServer, tasks: Iterable[Task], limits: Limits
) -> tuple[BlankAnswer, ...]:
    """Make sure that a policy server answers with an action of each task, and return its answers.

    Args:
        address: `ws://` or `wss://`.
        server: what submission.yaml says of it.
        tasks: that it is to play.
        limits: those by the clock hold.

    Raises:
        AddressInvalid: the address is none.
        PolicyFailed: it cannot be reached, or would fail an episode.
        EpisodeCut: it cut the line.
    """
    answers = []
    with RemoteSession(address, server, limits) as session:
        for task in tasks:
            keys = server.keys or [row.name for row in task.observables]
            blank = {row.name: np.zeros(row.shape, row.dtype) for row in task.observables if row.name in keys}
            with session.episode(task=task.name, action_shape=(len(task.actions),)) as policy:
                action = policy.act(blank)
            low, high = float(action.min()), float(action.max())
            answers.append(BlankAnswer(task=task.name, answer_s=policy.answers_s[0], low=low, high=high))
    return tuple(answers)
