"""What an env step of an insertion task is judged by, and its flags."""

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..ending import Flags, surface_moved_too_far
from .offset import PegOffset

OffsetT = TypeVar("OffsetT", bound=PegOffset)


@dataclass(frozen=True, kw_only=True)
class InsertionState(Generic[OffsetT]):
    """What an env step is judged by.

    Attributes:
        env_steps: played so far, this one included.
        offset: commanded offset from the hole.
        surface_diff_m: of the left and the right sensor [m], shape [2].
        peg_relative_z_mm: height of each bottom corner of the peg above the rim, measured [mm], shape [n].
    """

    env_steps: int
    offset: OffsetT
    surface_diff_m: NDArray[np.float64]
    peg_relative_z_mm: NDArray[np.float64]

    def is_deeper_than(self, depth_mm: float) -> bool:
        """Return whether all of the peg's lower end is further below the rim than this [mm]."""
        return bool((self.peg_relative_z_mm < -depth_mm).all())


def compute_flags(state: InsertionState[OffsetT], *, max_steps: int, left_range: bool, reached: bool) -> Flags:
    """Return the flags of an env step; the goal counts as reached only where no other flag is raised.

    A large surface motion is such a flag rather than a threshold of its own [D7].
    """
    tactile = surface_moved_too_far(state.surface_diff_m)
    steps = state.env_steps >= max_steps
    return Flags(
        tactile_movement_too_large=tactile,
        too_many_steps=steps,
        error_too_large=left_range,
        is_success=reached and not (tactile or steps or left_range),
    )
