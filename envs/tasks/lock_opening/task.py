"""Goal of the lock task: flags, success and reward of an env step, as the 2025 code has them (challenge-facts 6.2)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..ending import Flags, surface_moved_too_far

FloatArray = NDArray[np.float64]

LARGEST_Y_M = 10e-3
Z_RANGE_M = (15e-3, 45e-3)
LARGEST_X_M = 110e-3
SUCCESS_Y_M = 2e-3
SUCCESS_Z_RANGE_M = (33e-3, 40e-3)
# Height the teeth are to have: in their slots once both are inside the lock, at the channel's ceiling before.
LIFTED_Z_M = 0.037
CEILING_Z_M = 0.030
_ERROR_PER_M = 500.0
_SURFACE_PENALTY_RANGE_MM = (0.2, 1.5)


@dataclass(frozen=True, kw_only=True, eq=False)
class LockState:
    """What an env step is judged by; points in the world, each of shape [4, 3] [m].

    Attributes:
        env_steps: played so far, this one included.
        rear_tooth_m: top corners of the key's rear measured tooth.
        front_tooth_m: top corners of the front measured tooth.
        rear_slot_m: lower corners of the slot for the rear tooth.
        front_slot_m: lower corners of the slot for the front tooth.
        entrance_m: corners of the lock's entrance face.
        surface_diff_m: of the left and the right sensor [m], shape [2].
    """

    env_steps: int
    rear_tooth_m: FloatArray
    front_tooth_m: FloatArray
    rear_slot_m: FloatArray
    front_slot_m: FloatArray
    entrance_m: FloatArray
    surface_diff_m: FloatArray


def judge_flags(state: LockState, *, max_steps: int) -> Flags:
    """Return the flags of an env step.

    Success means that both teeth stand in absolute windows, not that each is aligned with its slot [D8]; it asks for
    no flag. No angle is tested [D12].
    """
    teeth = (state.rear_tooth_m, state.front_tooth_m)
    return Flags(
        tactile_movement_too_large=surface_moved_too_far(state.surface_diff_m),
        error_too_large=any(_out_of_range(tooth) for tooth in teeth),
        too_many_steps=state.env_steps >= max_steps,
        is_success=all(_lifted(tooth, entrance_x_m=_mean(state.entrance_m)[0]) for tooth in teeth),
    )


def alignment_error(state: LockState) -> float:
    """Return the error e of the reward: 500 per metre of distance of both teeth from where they should be."""
    entrance_x_m = _mean(state.entrance_m)[0]
    inside = all(tooth[:, 0].max() < entrance_x_m for tooth in (state.rear_tooth_m, state.front_tooth_m))
    goal_z_m = LIFTED_Z_M if inside else CEILING_Z_M
    pairs = ((state.rear_tooth_m, state.rear_slot_m), (state.front_tooth_m, state.front_slot_m))
    return _ERROR_PER_M * sum(_distance_m(tooth, slot, goal_z_m) for tooth, slot in pairs)


def reward(
    flags: Flags,
    surface_diff_m: FloatArray,
    *,
    progress: float,
    step_penalty: float,
    final_reward: float,
    failure_penalty: float,
) -> float:
    """Return the reward of an env step: progress, less penalty and both surfaces' motion, plus the end's part [D11]."""
    final = 0.0
    if flags.is_success:
        final = final_reward
    elif flags.force_too_large or flags.tactile_movement_too_large or flags.error_too_large:
        final = -failure_penalty
    left, right = np.clip(surface_diff_m * 1e3, *_SURFACE_PENALTY_RANGE_MM).tolist()
    return float(-step_penalty + progress - (left + right) + final)


def _out_of_range(tooth_m: FloatArray) -> bool:
    x, y, z = _mean(tooth_m)
    low, high = Z_RANGE_M
    return abs(y) > LARGEST_Y_M or z > high or z < low or x > LARGEST_X_M


def _lifted(tooth_m: FloatArray, *, entrance_x_m: float) -> bool:
    x, z = tooth_m[:, 0], tooth_m[:, 2]
    low, high = SUCCESS_Z_RANGE_M
    inside = x.max() < entrance_x_m and x.min() > 0.0 and abs(_mean(tooth_m)[1]) < SUCCESS_Y_M
    return bool(inside and z.min() > low and z.max() < high)


def _distance_m(tooth_m: FloatArray, slot_m: FloatArray, goal_z_m: float) -> float:
    x, y, z = _mean(tooth_m)
    return abs(x - _mean(slot_m)[0]) + abs(goal_z_m - z) + abs(y)


def _mean(points_m: FloatArray) -> tuple[float, float, float]:
    x, y, z = (points_m[0] + points_m[1] + points_m[2] + points_m[3]).tolist()
    return x / 4.0, y / 4.0, z / 4.0
