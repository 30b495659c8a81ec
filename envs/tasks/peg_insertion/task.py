"""Goal of the peg task: flags and success of an env step, as the 2025 code has them (challenge-facts 6.1)."""

from ..ending import Flags
from ..insertion.offset import PegOffset, is_beyond
from ..insertion.state import InsertionState, compute_flags
from .definition import SUCCESS_DEPTH_MM
from .variation import LARGEST_THETA_DEG, LARGEST_XY_MM

SUCCESS_COMMANDED_DEPTH_MM = 0.35


def judge_flags(state: InsertionState[PegOffset], *, max_steps: int, z_step_mm: float) -> Flags:
    """Return the flags of an env step.

    The limits of the offset are tested once per env step on the commanded values, not after each IPC step as published
    [D3]. Success asks for the commanded *and* the measured depth [D6].
    """
    offset = state.offset
    left_range = (
        is_beyond(offset.x_mm, LARGEST_XY_MM)
        or is_beyond(offset.y_mm, LARGEST_XY_MM)
        or is_beyond(offset.theta_deg, LARGEST_THETA_DEG)
    )
    deep_enough = state.env_steps * z_step_mm > SUCCESS_COMMANDED_DEPTH_MM
    reached = deep_enough and state.is_deeper_than(SUCCESS_DEPTH_MM)
    return compute_flags(state, max_steps=max_steps, left_range=left_range, reached=reached)
