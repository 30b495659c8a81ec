"""What a policy sees of the markers: as many rows as in simulation, whatever number the trackers follow."""

import numpy as np
from numpy.typing import NDArray
from vitac.envs.errors import VitacError
from vitac.envs.tactile.sizes import MARKER_COUNT

from .tracker import MarkerFlow


class NoMarkerFollowed(VitacError):
    """A tracker follows no marker; clean or replace the gel, or let the tracker start again."""


def marker_flow(left: MarkerFlow, right: MarkerFlow, generator: np.random.Generator) -> NDArray[np.float32]:
    """Return the observation `marker_flow` of the ranked tasks, shape [2, 2, 128, 2] [pixel].

    By the rule of the simulation (challenge-facts 4.2): of 128 or more markers 128 are chosen without replacement, of
    fewer the last one is repeated.

    Raises:
        NoMarkerFollowed: naming the side.
    """
    sides = {"left": left, "right": right}
    return np.stack([_rows(name, flow, generator) for name, flow in sides.items()])


def _rows(side: str, flow: MarkerFlow, generator: np.random.Generator) -> NDArray[np.float32]:
    count = len(flow.current)
    if not count:
        raise NoMarkerFollowed(f"Expected markers on the {side} gel, got none. Clean or replace it.")
    rows = np.minimum(np.arange(MARKER_COUNT), count - 1)
    if count >= MARKER_COUNT:
        rows = generator.choice(count, MARKER_COUNT, replace=False)
    return np.stack((flow.reference[rows], flow.current[rows])).astype(np.float32)
