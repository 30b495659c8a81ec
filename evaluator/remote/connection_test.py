"""Asks a policy server one blank observation of each task; called at an upload, before anything is queued."""

from collections.abc import Iterable

import numpy as np

from ..agent.limits import Limits
from ..tracks import Task
from .description import RemoteServer
from .session import RemoteSession


def test_connection(address: str, server: RemoteServer, tasks: Iterable[Task], limits: Limits) -> None:
    """Make sure that a policy server answers with an action of each task.

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
    with RemoteSession(address, server, limits) as session:
        for task in tasks:
            keys = server.keys or [row.name for row in task.observables]
            blank = {row.name: np.zeros(row.shape, row.dtype) for row in task.observables if row.name in keys}
            with session.episode(task=task.name, action_shape=(len(task.actions),)) as policy:
                policy.act(blank)
