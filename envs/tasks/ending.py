"""How an env step is judged and why an episode ends; the same words in every task."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

# Mean motion of a sensing surface that raises `tactile_movement_too_large`.
LARGEST_SURFACE_DIFF_M = 1.5e-3


class EndReason(StrEnum):
    """Why an episode ended; where several hold, the first of them in this order is given."""

    NOT_CONVERGED = "not_converged"  # the physics found no solution; nothing moves from then on
    SUCCESS = "success"  # the goal is reached
    FORCE = "force"  # the force on the held part was above the limit, where a task has one
    TACTILE = "tactile"  # a sensing surface moved too far
    ERROR = "error"  # the gripper or the part left its range
    STEPS = "steps"  # the env steps are used up


@dataclass(frozen=True, kw_only=True)
class Flags:
    """Flags of an env step; several can be raised at once. What success asks of the others is the task's to say."""

    force_too_large: bool = False
    tactile_movement_too_large: bool = False
    error_too_large: bool = False
    too_many_steps: bool = False
    is_success: bool = False

    @property
    def failure(self) -> EndReason | None:
        """The flag that cuts the episode off, if any: force before tactile before error before steps."""
        if self.force_too_large:
            return EndReason.FORCE
        if self.tactile_movement_too_large:
            return EndReason.TACTILE
        if self.error_too_large:
            return EndReason.ERROR
        return EndReason.STEPS if self.too_many_steps else None


def surface_moved_too_far(surface_diff_m: NDArray[np.float64]) -> bool:
    """Return whether the mean motion of a sensing surface since the grasp [m], shape [2], is more than allowed."""
    return bool((surface_diff_m > LARGEST_SURFACE_DIFF_M).any())
