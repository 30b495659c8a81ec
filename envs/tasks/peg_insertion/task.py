"""Goal of the peg task: flags and success of an env step, as the 2025 code has them (challenge-facts 6.1)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..ending import Flags, surface_moved_too_far
from .variation import LARGEST_THETA_DEG, LARGEST_XY_MM, PegOffset

SUCCESS_DEPTH_MM = 0.3
SUCCESS_COMMANDED_DEPTH_MM = 0.35
_LIMIT_TOLERANCE = 1e-5


@dataclass(frozen=True, kw_only=True)
class PegState:
    """What an env step is judged by.

    Attributes:
        env_steps: played so far, this one included.
        offset: commanded offset from the hole.
        surface_diff_m: of the left and the right sensor [m], shape [2].
        peg_relative_z_mm: height of each bottom corner above the plate, measured [mm], shape [n].
    """

    env_steps: int
    offset: PegOffset
    surface_diff_m: NDArray[np.float64]
    peg_relative_z_mm: NDArray[np.float64]


def judge_flags(state: PegState, *, max_steps: int, z_step_mm: float) -> Flags:
    """Return the flags of an env step.

    The limits of the offset are tested once per env step on the commanded values, not after each IPC step as published
    [D3]. Success asks for the commanded *and* the measured depth [D6], and for no flag; a large surface motion is such
    a flag rather than a threshold of its own [D7].
    """
    tactile = surface_moved_too_far(state.surface_diff_m)
    steps = state.env_steps >= max_steps
    error = (
        max(abs(state.offset.x_mm), abs(state.offset.y_mm)) > LARGEST_XY_MM + _LIMIT_TOLERANCE
        or abs(state.offset.theta_deg) > LARGEST_THETA_DEG + _LIMIT_TOLERANCE
    )
    deep_enough = state.env_steps * z_step_mm > SUCCESS_COMMANDED_DEPTH_MM
    inside = bool((state.peg_relative_z_mm < -SUCCESS_DEPTH_MM).all())
    return Flags(
        tactile_movement_too_large=tactile,
        too_many_steps=steps,
        error_too_large=error,
        is_success=deep_enough and inside and not (tactile or steps or error),
    )
