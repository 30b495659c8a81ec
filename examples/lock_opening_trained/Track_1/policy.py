"""Opens locks by sixteen numbers: each component of the action is a weighted sum of what is felt and remembered.

This file is a whole submission with `weights.npz` beside it, and needs only NumPy. The search imports the same file, so
that what is found is what is played. It looks at the markers of both gels and at nothing else.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SHIFT_PX = 10.0  # of the markers, a large one
ROTATION_RAD = 0.01  # of the handle between the gels, as under the ceiling of the lock
PULL_MM = 2.0  # motion inwards of an action of 1
FAR_MM = 4.0  # of the gripper outwards
LONG_ENV_STEPS = 4.0
FEATURES = 8
ACTIONS = 2


class Policy:
    """Plays lock opening by the weights in `weights.npz`, shape [ACTIONS, FEATURES]."""

    def __init__(self) -> None:
        with np.load(Path(__file__).parent / "weights.npz", allow_pickle=False) as stored:
            self.weights = stored["weights"]

    def reset(self, task: str) -> None:
        """Begin an episode."""
        self.opening = Opening(self.weights)

    def act(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[np.float32]:
        """Return the action."""
        return self.opening.act(observation["marker_flow"])


class Opening:
    """An episode: the weights, and what is remembered of it.

    Attributes:
        env_steps: played.
        pulled_mm: how far outwards the gripper was commanded.
    """

    def __init__(self, weights: FloatArray) -> None:
        self._weights = weights
        self.env_steps = 0
        self.pulled_mm = 0.0

    def act(self, marker_flow: NDArray[Any]) -> NDArray[np.float32]:
        """Return the weighted sums, clipped to -1 to 1, shape [ACTIONS]."""
        action = np.clip(self._weights @ self.features(marker_flow), -1.0, 1.0).astype(np.float32)
        self.env_steps += 1
        self.pulled_mm -= PULL_MM * float(action[0])
        return np.asarray(action)

    def features(self, marker_flow: NDArray[Any]) -> FloatArray:
        """Return what is weighted, shape [FEATURES].

        These are 1, the markers' shift into the lock and upwards, the rotation of the handle with its tip downwards,
        the same bounded, how far the gripper was pulled, the number of the env step, and whether it is the first.

        Args:
            marker_flow: reference and current markers of the left and the right gel [px], shape [2, 2, n, 2].
        """
        # The right sensor looks from the other side: what is up for the left one is down for it.
        (left_in, left_up, left_turn), (right_in, right_down, right_turn) = (
            rigid_motion(*flow) for flow in marker_flow
        )
        turn = (right_turn - left_turn) / 2 / ROTATION_RAD
        return np.array(
            [
                1.0,
                (left_in + right_in) / 2 / SHIFT_PX,
                (left_up - right_down) / 2 / SHIFT_PX,
                turn,
                np.tanh(turn),
                self.pulled_mm / FAR_MM,
                self.env_steps / LONG_ENV_STEPS,
                float(self.env_steps == 0),
            ]
        )


def rigid_motion(reference: NDArray[Any], current: NDArray[Any]) -> tuple[float, float, float]:
    """Return shift along u and v [px] and rotation from u to v [rad] that fit the motion of a gel's markers best."""
    count = 1 + int(np.argmax((reference == reference[-1]).all(axis=1)))  # the last marker is repeated to fill
    motion = (current - reference)[:count].astype(np.float64)
    shift = motion.mean(axis=0)
    place = (reference[:count] - reference[:count].mean(axis=0)).astype(np.float64)
    turn = (place[:, 0] * motion[:, 1] - place[:, 1] * motion[:, 0]).sum() / max((place**2).sum(), 1.0)
    return float(shift[0]), float(shift[1]), float(turn)
