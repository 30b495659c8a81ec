"""What the student believes: the offset that follows from what it knows and from its networks' first layers.

Fitted after the student has learned, by least squares, so that no action depends on it; it shows what is missing.
"""

from collections.abc import Mapping

import numpy as np

from ..episodes import Episodes
from ..submission.policy import belief_inputs
from .adam import FloatArray
from .student import student_inputs

OFFSET = slice(0, 3)
"""Where a row of `Episodes.truths` has the offset [mm, mm, deg]."""
_RIDGE = 3e-4
"""Weight of small weights beside the mean square error, for inputs that hardly differ."""


def fit_belief(weights: Mapping[str, FloatArray], episodes: Episodes) -> FloatArray:
    """Return the weights of the belief, shape [inputs, 3].

    Args:
        weights: of the student's networks, as `submission.policy.values` takes them.
        episodes: whose actions no truth has chosen.
    """
    looked = episodes.observations
    inputs = belief_inputs(weights, student_inputs(episodes)[looked]).astype(np.float64)
    offsets = episodes.truths[looked, OFFSET].astype(np.float64)
    squares = inputs.T @ inputs / len(inputs)
    found = np.linalg.solve(squares + _RIDGE * np.eye(len(squares)), inputs.T @ offsets / len(inputs))
    return np.asarray(found, dtype=np.float32)
