"""What a policy sees of the markers, and whether the gel that carries them is torn or covered."""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from vitac.envs.tactile.gel import MARKER_COUNT
from vitac.errors import VitacError

from .markers import MarkerFlow, Picture


class NoMarkerFollowed(VitacError):
    """A tracker follows no marker; clean or replace the gel, or let the tracker start again."""


def marker_flow(left: MarkerFlow, right: MarkerFlow, generator: np.random.Generator) -> NDArray[np.float32]:
    """Return the observation `marker_flow` of the ranked tasks, shape [2, 2, 128, 2] [pixel].

    By the rule of the simulation: of 128 or more markers 128 are chosen without replacement, of
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


_REGIONS: Final = 3
_REGION_PX: Final = (320.0 / _REGIONS, 240.0 / _REGIONS)
MIDDLE_REGION: Final = 4
"""Number of the region in the middle of the picture."""


def mean_by_region(flow: MarkerFlow) -> NDArray[np.float64]:
    """Return the mean movement of the markers in nine equal parts of the picture, by rows, shape [9, 2] [pixel].

    A part without markers has the mean of all of them.
    """
    movement = flow.current - flow.reference
    column, row = np.clip((flow.reference / _REGION_PX).astype(int), 0, _REGIONS - 1).T
    whole = movement.mean(axis=0) if len(movement) else np.zeros(2)
    number = _REGIONS * row + column
    means = [movement[number == each].mean(axis=0) if (number == each).any() else whole for each in range(_REGIONS**2)]
    return np.array(means)


Cells = NDArray[np.float32]

DAMAGED_PART: Final = 0.05
"""Part of the picture that may change so much; touch changes none (measured in tests/unit/station)."""
_CELLS: Final = (16, 12)
_CHANGE: Final = 0.5
"""Of a cell's brightness."""
_EVERY_PX: Final = 2


def measure_brightness(picture: Picture) -> Cells:
    """Return the brightness of each cell of a camera's picture, shape [12, 16]."""
    import cv2

    cells = cv2.resize(picture[::_EVERY_PX, ::_EVERY_PX], _CELLS, interpolation=cv2.INTER_AREA)
    return np.asarray(np.mean(cells, axis=2, dtype=np.float32), dtype=np.float32)


def find_changed_part(before: Cells, now: Cells) -> float:
    """Return the part of a picture whose brightness has changed by half or more."""
    return float((np.abs(now - before) >= _CHANGE * before).mean())
