"""Goal of the fusion task: flags and success of an env step, as in the 2025 code (challenge-facts 6.3)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry.bases import RIM_MM
from ..ending import Flags, surface_moved_too_far
from .variation import LARGEST_THETA_DEG, LARGEST_X_MM, LARGEST_Y_MM, LARGEST_Z_MM, FusionOffset

# Only a peg in the right hole is as near as this to it.
SUCCESS_XY_MM = 6.0
SUCCESS_THETA_DEG = 10.0
_LIMIT_TOLERANCE = 1e-5


@dataclass(frozen=True, kw_only=True)
class FusionState:
    """What an env step is judged by.

    Attributes:
        env_steps: played so far, this one included.
        offset: commanded offset from the right hole.
        surface_diff_m: of the left and the right sensor [m], shape [2].
        peg_relative_z_mm: height of each bottom corner above the rim, measured [mm], shape [n].
    """

    env_steps: int
    offset: FusionOffset
    surface_diff_m: NDArray[np.float64]
    peg_relative_z_mm: NDArray[np.float64]


def judge_flags(state: FusionState, *, max_steps: int, insertion_depth_mm: float) -> Flags:
    """Return the flags of an env step; success asks for depth, for the right hole, and for no flag."""
    tactile = surface_moved_too_far(state.surface_diff_m)
    steps = state.env_steps >= max_steps
    error = _left_range(state.offset)
    inside = bool((state.peg_relative_z_mm < -insertion_depth_mm).all())
    return Flags(
        tactile_movement_too_large=tactile,
        too_many_steps=steps,
        error_too_large=error,
        is_success=inside and _is_at_target(state.offset) and not (tactile or steps or error),
    )


def _left_range(offset: FusionOffset) -> bool:
    """Return whether an offset is beyond a limit; its z is compared with the rim's height, as the challenge does."""
    return (
        abs(offset.x_mm) > LARGEST_X_MM + _LIMIT_TOLERANCE
        or abs(offset.y_mm) > LARGEST_Y_MM + _LIMIT_TOLERANCE
        or abs(offset.theta_deg) > LARGEST_THETA_DEG + _LIMIT_TOLERANCE
        or abs(offset.z_mm - RIM_MM) > LARGEST_Z_MM + _LIMIT_TOLERANCE
    )


def _is_at_target(offset: FusionOffset) -> bool:
    near = abs(offset.x_mm) < SUCCESS_XY_MM and abs(offset.y_mm) < SUCCESS_XY_MM
    return near and abs(offset.theta_deg) < SUCCESS_THETA_DEG
