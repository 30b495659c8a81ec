"""How states, histories and actions look in a mirror with normal x, and after half a turn about the vertical.

Every peg with its hole is the same in the mirror; cuboid and bow tie are the same after half a turn too. So every
episode is worth two or four.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..submission.policy import MAX_STEPS
from .adam import FloatArray

TURNABLE = (0, 2)
"""Numbers of the shapes that look the same after half a turn: cuboid and bow tie."""
_MIRROR_ACTION = np.array([-1, 1, -1], dtype=np.float32)
_TURN_ACTION = np.array([-1, -1, 1], dtype=np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class Signs:
    """Signs by which the numbers of an input are multiplied.

    Attributes:
        mirror: in a mirror with normal x, shape [i].
        turn: after half a turn about z, shape [i].
    """

    mirror: FloatArray
    turn: FloatArray

    def changed(
        self, inputs: FloatArray, actions: FloatArray, flips: NDArray[np.bool_], turns: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray]:
        """Return inputs, shape [n, i], and actions, shape [n, 3] or [n, k, 3], the chosen ones mirrored or turned."""
        inputs = np.where(flips[:, None], inputs * self.mirror, inputs)
        inputs = np.where(turns[:, None], inputs * self.turn, inputs)
        rows = flips.reshape(-1, *[1] * (actions.ndim - 1)), turns.reshape(-1, *[1] * (actions.ndim - 1))
        actions = np.where(rows[0], actions * _MIRROR_ACTION, actions)
        return inputs, np.where(rows[1], actions * _TURN_ACTION, actions)

    def drawn(
        self, inputs: FloatArray, actions: FloatArray, turnable: NDArray[np.bool_], random: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Return inputs and actions, each half of the times mirrored, and turned where half a turn changes nothing."""
        flips, turns = random.integers(2, size=(2, len(inputs))) == 1
        return self.changed(inputs, actions, flips, turns & turnable)


def both(first: Signs, second: Signs) -> Signs:
    """Return the signs of two inputs side by side."""
    return Signs(mirror=np.concatenate([first.mirror, second.mirror]), turn=np.concatenate([first.turn, second.turn]))


def _signs(mirror: list[int], turn: list[int]) -> Signs:
    return Signs(mirror=np.array(mirror, dtype=np.float32), turn=np.array(turn, dtype=np.float32))


# x, y, theta; x, y in the gripper's axes; how far the peg is from its command: x, y, z, roll, pitch, yaw; env step;
# shape, one of three
STATE = _signs(
    [-1, 1, -1, -1, 1, -1, 1, 1, 1, -1, -1, 1, 1, 1, 1], [-1, -1, 1, -1, -1, -1, -1, 1, -1, -1, 1, 1, 1, 1, 1]
)
# shift x, y, z and turn about x, y, z that were felt; the gripper's x, y, theta; whether theta is known
_MOMENT = _signs([-1, 1, 1, 1, -1, -1, -1, 1, -1, 1], [-1, -1, 1, -1, -1, 1, -1, -1, 1, 1])
_STEPS = _signs([1] * MAX_STEPS, [1] * MAX_STEPS)
HISTORY = both(Signs(mirror=np.tile(_MOMENT.mirror, MAX_STEPS + 1), turn=np.tile(_MOMENT.turn, MAX_STEPS + 1)), _STEPS)
