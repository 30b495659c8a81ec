"""How a task is best looked at: from where, cut open where, which numbers are shown. Every task has its own."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
InfoView = Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Plane:
    """The plane normal . x = offset.

    Attributes:
        normal: unit vector.
        offset_m: distance from the origin along the normal [m].
    """

    normal: tuple[float, float, float]
    offset_m: float

    def heights_m(self, points_m: FloatArray) -> FloatArray:
        """Return the signed distances from the plane [m], positive on the normal's side, shape [..., 3] to [...]."""
        return np.asarray(points_m @ np.array(self.normal) - self.offset_m)


class Beside(StrEnum):
    """Where a name stands."""

    ABOVE = "above"
    BELOW = "below"
    LEFT = "left"


@dataclass(frozen=True, kw_only=True)
class SectionView:
    """A plane view of both parts, cut.

    Attributes:
        title: what is seen.
        held_cut: where the held part is cut.
        fixed_cut: where the fixed part is cut.
        axes: world axes to the right and upwards, as (index, name).
        limits_mm: what is shown along both: (low, high), (low, high) [mm].
    """

    title: str
    held_cut: Plane
    fixed_cut: Plane
    axes: tuple[tuple[int, str], tuple[int, str]]
    limits_mm: tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class ProgressPlot:
    """Heights by which success is judged.

    Attributes:
        title: what they are the heights of.
        heights_mm: their values from the info of an env step [mm].
        goal_mm: all must be beyond this [mm].
        goal_is_below: whether beyond means below.
    """

    title: str
    heights_mm: Callable[[InfoView], FloatArray]
    goal_mm: float
    goal_is_below: bool


@dataclass(frozen=True, kw_only=True)
class Perspective:
    """How a task is drawn.

    Attributes:
        held_name: of the held part.
        fixed_name: of the fixed part.
        azimuth_deg: of the eye, see `ParallelCamera`.
        elevation_deg: of the eye.
        gel_labels: on which side of the left and of the right gel its name has room.
        cut: the fixed part is taken away on this plane's positive side.
        section: the plane view beside it.
        progress: what the time line shows.
        position: the held part's place, in words, from the info of an env step.
        arrival: what the held part has done when the task is solved, in words.
    """

    held_name: str
    fixed_name: str
    azimuth_deg: float
    elevation_deg: float
    gel_labels: tuple[Beside, Beside]
    cut: Plane
    section: SectionView
    progress: ProgressPlot
    position: Callable[[InfoView], str]
    arrival: str = "reached its goal"


def signed(value: float) -> str:
    """Return a number as it is shown in a `position`: with its sign, two places and a true minus."""
    return f"{value:+z.2f}".replace("-", "−")


ActionArray = NDArray[np.float32]


NextAction = Callable[[dict[str, NDArray[Any]], dict[str, Any]], ActionArray]
"""Chooses an action from an observation and the info given with it."""


DESCRIPTION = "straight to the target, which no policy sees"


def longest_action(distance: NDArray[np.float64], scale: NDArray[np.float64]) -> ActionArray:
    """Return the longest action along a straight line that does not go beyond its end.

    Args:
        distance: from here to the end, in the units of the action's scale, shape [a].
        scale: motion at an action of 1, shape [a].
    """
    action = distance / scale
    return np.asarray(action / max(1.0, float(np.abs(action).max())), dtype=np.float32)
