"""Follows the markers of a gel by assigning all of them at once, so that none is lost for good.

Beside the challenge's tracker (`tracker.py`) it differs in four things: centres are weighted by darkness; markers and
centres are paired so that the sum of squared distances is smallest; a lost marker is expected where its neighbours have
moved to, and taken up there again; and a gel whose markers only tremble is at rest. It never starts again by itself.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .markers import HEIGHT, WIDTH, Picture, Positions, cut_picture, find_blobs, marker_darkness
from .tracker import DROPPED_PICTURES, MarkerFlow

_WINDOW_PX: Final = 7
_NEIGHBOURS: Final = 4
_FARTHEST_PX: Final = 16.0
"""Half the distance between markers: beyond it another marker is nearer."""

_REST_PX: Final = 0.035
"""More than gels at rest show, up to 0.031 with twice the noise and worn markers (benchmarks/station/tracker.py)."""


@dataclass
class AssignedMarkerTracker:
    """A tracker that assigns all markers at once; used as `MarkerTracker`."""

    _seen: int = 0
    _reference: Positions = field(default_factory=lambda: np.empty((0, 2)))
    _movement: Positions = field(default_factory=lambda: np.empty((0, 2)))
    _velocity: Positions = field(default_factory=lambda: np.empty((0, 2)))
    _found: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))

    def see(self, picture: Picture) -> MarkerFlow | None:
        """Take the next picture of the camera; return None for the first ones, which are dropped."""
        self._seen += 1
        if self._seen <= DROPPED_PICTURES:
            return None
        centres = find_centres(cut_picture(picture))
        if self._seen == DROPPED_PICTURES + 1:
            self._reference = centres
            self._movement, self._velocity = np.zeros_like(centres), np.zeros_like(centres)
            self._found = np.ones(len(centres), dtype=bool)
        elif len(self._reference):
            self._follow(centres)
        reference, movement = self._reference[self._found], self._movement[self._found]
        return MarkerFlow(reference, reference + movement * _is_beyond_noise(movement))

    def start_again(self) -> None:
        """Take the next picture for the reference, as the challenge's reset service does."""
        self._seen = min(self._seen, DROPPED_PICTURES)

    def _follow(self, centres: Positions) -> None:
        expected = self._movement + self._velocity
        before = self._movement.copy()
        markers, chosen = _assign(self._reference + expected, centres)
        self._found[:] = False
        self._found[markers] = True
        self._movement[markers] = centres[chosen] - self._reference[markers]
        if self._found.any():
            self._movement[~self._found] = self._neighbours_movement()
        self._velocity = self._movement - before

    def _neighbours_movement(self) -> Positions:
        """Return how the nearest markers that were found have moved, for each that was not, shape [n, 2]."""
        distances = np.linalg.norm(self._reference[~self._found, None] - self._reference[None, self._found], axis=2)
        nearest = np.argsort(distances, axis=1)[:, :_NEIGHBOURS]
        moved: Positions = self._movement[self._found][nearest].mean(axis=1)
        return moved


def _is_beyond_noise(movement: Positions) -> bool:
    """Say whether the markers have moved further, in the root mean square, than they tremble at rest."""
    return float(np.square(movement).sum()) > len(movement) * _REST_PX**2


def find_centres(picture: Picture) -> Positions:
    """Return the centres of all markers, each the mean of its pixels weighted by their darkness, shape [n, 2]."""
    darkness = marker_darkness(picture)
    centres = find_blobs(darkness)
    offsets = np.arange(-_WINDOW_PX, _WINDOW_PX + 1)
    for _ in range(2):  # the second window is about the better centre
        u = np.clip(np.rint(centres[:, 0, None]).astype(int) + offsets, 0, WIDTH - 1)[:, None, :]
        v = np.clip(np.rint(centres[:, 1, None]).astype(int) + offsets, 0, HEIGHT - 1)[:, :, None]
        window = darkness[v, u].astype(np.float64)
        window = np.clip(window - window.max(axis=(1, 2), keepdims=True) / 4, 0.0, None)
        total = window.sum(axis=(1, 2))
        centres = np.stack(((window * u).sum(axis=(1, 2)), (window * v).sum(axis=(1, 2))), axis=1) / total[:, None]
    return centres


def _assign(expected: Positions, centres: Positions) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which markers are paired with which centres; pairs farther than half a spacing are none."""
    from scipy.optimize import linear_sum_assignment

    squares = ((expected[:, None] - centres[None]) ** 2).sum(axis=2)
    limit = _FARTHEST_PX**2
    markers, chosen = linear_sum_assignment(np.minimum(squares, limit))
    is_near = squares[markers, chosen] < limit
    return markers[is_near], chosen[is_near]
