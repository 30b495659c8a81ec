"""Finds the markers of a gel in a picture and follows them from picture to picture.

Finding and `MarkerTracker` are the challenge's own (numbers: its ROS package): a marker that is lost stays lost until
the tracker starts again. `AssignedMarkerTracker` assigns all markers at once, so that none is lost for good: what is
dark in one light only is no marker; centres are weighted by darkness; markers and centres are paired so that the sum of
squared distances is smallest; a lost marker is expected where its neighbours have moved to; and a gel whose markers
only tremble is at rest.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Positions = NDArray[np.float64]

WIDTH, HEIGHT = 320, 240
_BORDER: Final = 7
"""A seventh of the picture is cut off at each border."""
_MORE_ROWS_AT_THE_TOP: Final = 2
_WIDE, _NARROW = (15, 15), (9, 9)
_GAIN: Final = 16.0
_DARKEST: Final = 3 * 255.0
_MARKER_SUM: Final = 76.0
_CLOSING: Final = 4
_MIN_DISTANCE_PX: Final = 12.0
_AREA_PX: Final = (25.0, 400.0)
_THRESHOLDS: Final = (1.0, 2.0, 0.5)
"""The challenge's thresholds reach 20, but a mask has two values: all give the same blobs, and two must agree."""


def cut_picture(picture: Picture) -> Picture:
    """Cut off the borders of a camera's picture and scale it, shape [240, 320, 3]; lens distortion stays."""
    import cv2

    rows, columns = picture.shape[0] // _BORDER, picture.shape[1] // _BORDER
    middle = picture[rows + _MORE_ROWS_AT_THE_TOP : picture.shape[0] - rows, columns : picture.shape[1] - columns]
    return np.asarray(cv2.resize(middle, (WIDTH, HEIGHT)), dtype=np.uint8)


def marker_darkness(picture: Picture) -> NDArray[np.float32]:
    """Return how much darker each pixel is than its surroundings, summed over the colours, shape [240, 320]."""
    import cv2

    wide, narrow = cv2.GaussianBlur(picture, _WIDE, 0), cv2.GaussianBlur(picture, _NARROW, 0)
    difference = cv2.convertScaleAbs(cv2.subtract(wide, narrow), alpha=_GAIN)  # both cut off at 0 and 255
    total = _sum_colours(difference)
    return np.asarray(cv2.GaussianBlur(total, _WIDE, 0), dtype=np.float32)  # of the sum: that of each colour, summed


def _sum_colours(picture: NDArray[Any]) -> NDArray[np.float32]:
    import cv2

    return np.asarray(cv2.transform(picture.astype(np.float32), np.ones((1, 3), np.float32)), dtype=np.float32)


def find_markers(picture: Picture) -> Positions:
    """Return the centres of all markers of a cut picture, shape [n, 2] [pixel]."""
    return find_blobs(marker_darkness(picture))


def find_blobs(darkness: NDArray[np.float32]) -> Positions:
    """Return the centres of what is dark enough for a marker, shape [n, 2] [pixel]."""
    import cv2

    mask = (darkness > _MARKER_SUM).astype(np.uint8) * 255
    square = np.ones((3, 3), np.uint8)
    closed = cv2.erode(cv2.dilate(mask, square, iterations=_CLOSING), square, iterations=_CLOSING)
    blobs = _detector().detect(255 - closed)
    return np.array([blob.pt for blob in blobs], dtype=np.float64).reshape(-1, 2)


@cache
def _detector() -> Any:
    cv2: Any = import_module("cv2")  # its types lack these names
    settings = cv2.SimpleBlobDetector_Params()
    settings.minThreshold, settings.maxThreshold, settings.thresholdStep = _THRESHOLDS
    settings.minDistBetweenBlobs = _MIN_DISTANCE_PX
    settings.filterByArea = True
    settings.minArea, settings.maxArea = _AREA_PX
    settings.filterByCircularity = settings.filterByConvexity = settings.filterByInertia = False
    return cv2.SimpleBlobDetector_create(settings)


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
        positions = self.find(cut_picture(picture))
        if self._seen == DROPPED_PICTURES + 1:
            self._start(positions)
        else:
            self._follow(positions)
        flow = MarkerFlow(self._reference[~self._lost], self._current[~self._lost])
        self._still = 0 if flow.is_contact() else self._still + 1
        if self._still >= _STILL_PICTURES:
            self._start(positions)
        return flow

    def start_again(self) -> None:
        """Take the next picture for the reference, as the challenge's reset service does."""
        self._seen = min(self._seen, DROPPED_PICTURES)

    def _start(self, positions: Positions) -> None:
        self._reference, self._current = positions, positions.copy()
        self._lost, self._still = np.zeros(len(positions), dtype=bool), 0

    def _follow(self, positions: Positions) -> None:
        """Move each marker to the nearest one found; of two that want the same, the farther is lost."""
        followed = np.flatnonzero(~self._lost)
        if not len(positions) or not len(followed):
            self._lost[:] = True
            return
        distances = np.linalg.norm(self._current[followed, None] - positions[None], axis=2)
        nearest, distance = distances.argmin(axis=1), distances.min(axis=1)
        order = np.argsort(distance, kind="stable")
        _, first = np.unique(nearest[order], return_index=True)
        closest = np.zeros(len(followed), dtype=bool)
        closest[order[first]] = True
        is_kept = closest & (distance <= _FARTHEST_PX)
        self._current[followed[is_kept]] = positions[nearest[is_kept]]
        self._lost[followed[~is_kept]] = True


_WINDOW_PX: Final = 7
_NEIGHBOURS: Final = 4
_FARTHEST_ASSIGNED_PX: Final = 16.0
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


def _darkness_in_all_lights(picture: Picture) -> NDArray[np.float32]:
    """Return `marker_darkness` with the colours summed first: what one light leaves dark another one lights.

    So the edges of what is pressed into a gel are no markers, and do not grow together with those beside them.
    """
    import cv2

    total = _sum_colours(picture)
    difference = cv2.subtract(cv2.GaussianBlur(total, _WIDE, 0), cv2.GaussianBlur(total, _NARROW, 0))
    darkness = np.clip(_GAIN * difference, 0.0, _DARKEST)
    return np.asarray(cv2.GaussianBlur(darkness, _WIDE, 0), dtype=np.float32)


def find_centres(picture: Picture) -> Positions:
    """Return the centres of all markers, each the mean of its pixels weighted by their darkness, shape [n, 2]."""
    darkness = _darkness_in_all_lights(picture)
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
    limit = _FARTHEST_ASSIGNED_PX**2
    markers, chosen = linear_sum_assignment(np.minimum(squares, limit))
    is_near = squares[markers, chosen] < limit
    return markers[is_near], chosen[is_near]
