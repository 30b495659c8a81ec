"""Actions that are good to look at where no policy is given: straight to the target, which a policy cannot see."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
