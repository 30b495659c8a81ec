"""Follows the markers of a gel from picture to picture, by the challenge's own rules.

A marker that is lost stays lost until the tracker starts again, and only the others are given: their number varies.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .markers import Picture, Positions, cut_picture, find_markers

DROPPED_PICTURES: Final = 10
"""The first pictures of a camera, while its exposure settles."""
_FARTHEST_PX: Final = 31.25
_CONTACT_PX: Final = 0.5
_OVER_FORCE_PX: Final = 30.0
_STILL_PICTURES: Final = 10
"""After as many without contact the tracker starts again, so that slow drift does not become a movement."""


class MarkerFlow(NamedTuple):
    """Markers that are not lost.

    Attributes:
        reference: where each was when the tracker started, shape [n, 2] [pixel].
        current: where it is, shape [n, 2] [pixel].
    """

    reference: Positions
    current: Positions

    def largest_movement_px(self) -> float:
        """Return the largest movement of a marker."""
        return float(np.hypot(*(self.current - self.reference).T).max(initial=0.0))

    def mean_movement_px(self) -> float:
        """Return the mean movement of the markers."""
        return float(np.hypot(*(self.current - self.reference).T).mean()) if len(self.current) else 0.0

    def is_contact(self) -> bool:
        """Say whether a marker has moved, by the challenge's rule without depth."""
        return self.largest_movement_px() > _CONTACT_PX

    def is_over_force(self) -> bool:
        """Say whether a marker has moved too far, by the same rule."""
        return self.largest_movement_px() > _OVER_FORCE_PX


@dataclass
class MarkerTracker:
    """The challenge's tracker.

    Attributes:
        find: returns the markers of a cut picture.
    """

    find: Callable[[Picture], Positions] = find_markers
    _seen: int = 0
    _still: int = 0
    _reference: Positions = field(default_factory=lambda: np.empty((0, 2)))
    _current: Positions = field(default_factory=lambda: np.empty((0, 2)))
    _lost: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))

    def see(self, picture: Picture) -> MarkerFlow | None:
        """Take the next picture of the camera; return None for the first ones, which are dropped."""
        self._seen += 1
        if self._seen <= DROPPED_PICTURES:
            return None
        found = self.find(cut_picture(picture))
        if self._seen == DROPPED_PICTURES + 1:
            self._start(found)
        else:
            self._follow(found)
        flow = MarkerFlow(self._reference[~self._lost], self._current[~self._lost])
        self._still = 0 if flow.is_contact() else self._still + 1
        if self._still >= _STILL_PICTURES:
            self._start(found)
        return flow

    def start_again(self) -> None:
        """Take the next picture for the reference, as the challenge's reset service does."""
        self._seen = min(self._seen, DROPPED_PICTURES)

    def _start(self, found: Positions) -> None:
        self._reference, self._current = found, found.copy()
        self._lost, self._still = np.zeros(len(found), dtype=bool), 0

    def _follow(self, found: Positions) -> None:
        """Move each marker to the nearest one found; of two that want the same, the farther is lost."""
        followed = np.flatnonzero(~self._lost)
        if not len(found) or not len(followed):
            self._lost[:] = True
            return
        distances = np.linalg.norm(self._current[followed, None] - found[None], axis=2)
        nearest, distance = distances.argmin(axis=1), distances.min(axis=1)
        order = np.argsort(distance, kind="stable")
        _, first = np.unique(nearest[order], return_index=True)
        closest = np.zeros(len(followed), dtype=bool)
        closest[order[first]] = True
        is_kept = closest & (distance <= _FARTHEST_PX)
        self._current[followed[is_kept]] = found[nearest[is_kept]]
        self._lost[followed[~is_kept]] = True
