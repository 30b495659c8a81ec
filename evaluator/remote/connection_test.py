"""Asks a policy server one blank observation of each task; called at an upload, before anything is queued."""

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..agent.limits import Limits
from ..tracks import Task
from .description import RemoteServer
from .session import RemoteSession


@dataclass(frozen=True, kw_only=True)
class TestedTask:
    """What a policy server answered to a blank observation.

    Attributes:
        task: its name.
        answer_s: time until its answer [s].
        lowest: smallest number of its action, which evaluations clip to [-1, 1].
        highest: largest one.
    """

    task: str
    answer_s: float
    lowest: float
    highest: float


def test_connection(
    address: str, server: RemoteServer, tasks: Iterable[Task], limits: Limits
) -> tuple[TestedTask, ...]:
    """Return the answers of a policy server.

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
    tested = []
    with RemoteSession(address, server, limits) as session:
        for task in tasks:
            keys = server.keys or [row.name for row in task.observables]
            blank = {row.name: np.zeros(row.shape, row.dtype) for row in task.observables if row.name in keys}
            started_s = time.monotonic()
            with session.episode(task=task.name, action_shape=(len(task.actions),)) as policy:
                action = policy.act(blank)
            answer_s = time.monotonic() - started_s
            tested.append(
                TestedTask(task=task.name, answer_s=answer_s, lowest=float(action.min()), highest=float(action.max()))
            )
    return tuple(tested)
