"""Whether two evaluations of one episode list are so alike that one was made from the other; called by the service.

Two policies that were made apart see the same noise and still act differently in most episodes; recorded actions that
were changed a little, and weights with a little noise, do not. What everybody does in every episode, and actions at
their limits, are no evidence.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Trace = NDArray[np.float32]
"""The first actions of each episode, shape [episodes, TRACED_STEPS, action size]; NaN after the end of an episode."""

TRACED_STEPS: Final = 8
TOLERANCE: Final = 0.02
"""Difference of an action, in [-1, 1], and of the motion that was commanded until then, of which a copy stays below."""
MAX_DELAY: Final = 2
"""Maximum delay of a copy's motion in env steps, after actions that move hardly anything."""
_AT_LIMIT: Final = 0.999
_FEWEST_VALUES: Final = 2
"""Minimum number of actions that only this episode has, for a comparison to say something."""


@dataclass(frozen=True, kw_only=True)
class Likeness:
    """How alike two evaluations are.

    Attributes:
        episodes: that both have and that say something.
        near: those of them whose actions, or commanded motions, are within the tolerance; equal ones count once.
        difference: median over the episodes of the largest difference of an action.
    """

    episodes: int
    near: int
    difference: float

    @property
    def is_copy(self) -> bool:
        """Whether one was made from the other: half of the episodes or more are near."""
        return self.near > 0 and 2 * self.near >= self.episodes


def make_trace(actions: Sequence[NDArray[np.float32]], size: int) -> Trace:
    """Return the trace of episodes.

    Args:
        actions: of each episode of a list, in their order, shape [env steps, size].
        size: of an action.
    """
    trace = np.full((len(actions), TRACED_STEPS, size), np.nan, np.float32)
    for row, of_episode in zip(trace, actions, strict=True):
        played = of_episode[:TRACED_STEPS].reshape(-1, size)
        row[: len(played)] = played
    return trace


def compare_traces(earlier: Trace, later: Trace) -> Likeness:
    """Return how alike two evaluations of the same episodes are."""
    if earlier.shape != later.shape or not earlier.size:
        return Likeness(episodes=0, near=0, difference=np.inf)
    own = _own_values(earlier)
    says_something = own.sum(axis=(1, 2)) >= _FEWEST_VALUES
    differences = _largest(earlier - later)
    near = says_something & ((differences <= TOLERANCE) | _moves_alike(earlier, later))
    rows = np.where(own, earlier, 0.0)[near].round(3) + 0.0
    return Likeness(
        episodes=int(says_something.sum()),
        near=len(np.unique(rows.reshape(len(rows), -1), axis=0)) if near.any() else 0,
        difference=float(np.median(differences[says_something])) if says_something.any() else np.inf,
    )


def _own_values(trace: Trace) -> NDArray[np.bool_]:
    """Return which actions are neither at their limit nor what the policy does at that env step in every episode."""
    is_there = ~np.isnan(trace)
    first = np.where(is_there, trace, np.inf).min(axis=0)
    last = np.where(is_there, trace, -np.inf).max(axis=0)
    own: NDArray[np.bool_] = is_there & (np.abs(np.nan_to_num(trace)) < _AT_LIMIT) & (last - first > TOLERANCE)
    return own


def _moves_alike(earlier: Trace, later: Trace) -> NDArray[np.bool_]:
    """Return in which episodes the later one commands the earlier one's motion, perhaps some env steps later."""
    ours, theirs = (np.where(np.isnan(trace), 0.0, trace).cumsum(axis=1) for trace in (earlier, later))
    found = np.zeros(len(earlier), bool)
    for delay in range(MAX_DELAY + 1):
        waits = np.abs(theirs[:, :delay]).max(axis=(1, 2), initial=0.0) <= TOLERANCE
        lead = np.where(np.isnan(earlier[:, : TRACED_STEPS - delay]), np.nan, ours[:, : TRACED_STEPS - delay])
        found |= waits & (_largest(lead - theirs[:, delay:]) <= TOLERANCE)
    return found


def _largest(differences: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the largest difference of each episode over the env steps that both have; infinite without any."""
    sizes = np.abs(differences)
    return np.where(np.isnan(sizes).all(axis=(1, 2)), np.inf, np.where(np.isnan(sizes), 0.0, sizes).max(axis=(1, 2)))
