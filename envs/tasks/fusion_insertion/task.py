"""Goal of the fusion task: flags and success of an env step, as in the 2025 code (challenge-facts 6.3)."""

from ...geometry.bases import RIM_MM
from ..ending import Flags
from ..insertion.offset import is_beyond
from ..insertion.state import InsertionState, compute_flags
from .variation import LARGEST_THETA_DEG, LARGEST_X_MM, LARGEST_Y_MM, LARGEST_Z_MM, FusionOffset

# Only a peg in the right hole is as near as this to it.
SUCCESS_XY_MM = 6.0
SUCCESS_THETA_DEG = 10.0


def judge_flags(state: InsertionState[FusionOffset], *, max_steps: int, insertion_depth_mm: float) -> Flags:
    """Return the flags of an env step; success asks for depth, for the right hole, and for no flag."""
    reached = state.is_deeper_than(insertion_depth_mm) and _is_at_target(state.offset)
    return compute_flags(state, max_steps=max_steps, left_range=_left_range(state.offset), reached=reached)


def _left_range(offset: FusionOffset) -> bool:
    """Return whether an offset is beyond a limit; its z is compared with the rim's height, as the challenge does."""
    return (
        is_beyond(offset.x_mm, LARGEST_X_MM)
        or is_beyond(offset.y_mm, LARGEST_Y_MM)
        or is_beyond(offset.theta_deg, LARGEST_THETA_DEG)
        or is_beyond(offset.z_mm - RIM_MM, LARGEST_Z_MM)
    )


def _is_at_target(offset: FusionOffset) -> bool:
    near = abs(offset.x_mm) < SUCCESS_XY_MM and abs(offset.y_mm) < SUCCESS_XY_MM
    return near and abs(offset.theta_deg) < SUCCESS_THETA_DEG
