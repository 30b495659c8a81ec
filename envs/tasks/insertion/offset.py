"""Where a peg is commanded to be, relative to its hole."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

_LIMIT_TOLERANCE = 1e-5


@dataclass(frozen=True, kw_only=True)
class PegOffset:
    """Pose of the peg (and the gripper) relative to its hole.

    Attributes:
        x_mm: world x [mm].
        y_mm: world y [mm].
        theta_deg: about the vertical [deg].
    """

    x_mm: float
    y_mm: float
    theta_deg: float

    def magnitude(self) -> float:
        """Return the euclidean norm of the numbers in mm and degrees, the error e of the reward."""
        return norm(self.as_tuple())

    def as_array(self) -> NDArray[np.float64]:
        """Return x [mm], y [mm], theta [deg] and what a task adds to them, shape [3] or more."""
        return np.array(self.as_tuple())

    def as_tuple(self) -> tuple[float, ...]:
        """Return the same numbers; `dataclasses.astuple` copies each deeply, which takes thirty times as long."""
        return tuple(vars(self).values())


def norm(values: Iterable[float]) -> float:
    """Return the euclidean norm."""
    return sqrt(sum(value * value for value in values))


def is_beyond(value: float, largest: float) -> bool:
    """Return whether a commanded value is beyond its limit either way, by more than rounding."""
    return abs(value) > largest + _LIMIT_TOLERANCE
