"""Actions that are good to look at where no policy is given: straight to the target, which a policy cannot see."""

from collections.abc import Callable
from math import radians

import numpy as np
from numpy.typing import NDArray

from ..deterministic_math import sine_cosine
from ..tasks.lock_opening.settings import LockOpeningSettings
from ..tasks.lock_opening.task import SUCCESS_Z_RANGE_M
from ..tasks.lock_opening.variation import ENV_ID as LOCK_OPENING
from ..tasks.peg_insertion.settings import PegInsertionSettings
from ..tasks.peg_insertion.variation import ENV_ID as PEG_INSERTION
from ..tasks.task_env import Info, Observation
from .perspectives import NotDrawable

ActionArray = NDArray[np.float32]
DESCRIPTION = "straight to the target, which no policy sees"

# Above the least height at which the lock opens [mm].
_LIFT_MARGIN_MM = 0.5


def straight_to_target(env_id: str) -> Callable[[Observation, Info], ActionArray]:
    """Chooses actions from the info of an env step: in a straight line, as fast as the task allows.

    Raises:
        NotDrawable: nobody has said what the target of this environment is.
    """
    chosen = {PEG_INSERTION: _insert_peg, LOCK_OPENING: _open_lock}
    if env_id not in chosen:
        raise NotDrawable(f"No motion is known for {env_id}; give actions or a policy.")
    return chosen[env_id]


def _insert_peg(_: Observation, info: Info) -> ActionArray:
    """Take the offset away: x and y in the gripper's own axes, which turn with it, and the angle."""
    x_mm, y_mm, theta_deg = info["gt_offset_mm_deg"].tolist()
    sine, cosine = sine_cosine(radians(theta_deg))
    way = (-cosine * x_mm - sine * y_mm, sine * x_mm - cosine * y_mm, -theta_deg)
    return _in_proportion(np.array(way), np.array(PegInsertionSettings().action_scale_mm_deg))


def _open_lock(_: Observation, info: Info) -> ActionArray:
    """Out until the rear tooth is below its slot, and up into it, at once: the teeth rub along the ceiling."""
    tooth_m, slot_m = info["key1_pts_m"], info["lock1_pts_m"]
    inwards_mm = 1e3 * (tooth_m[:, 0].mean() - slot_m[:, 0].mean())
    down_mm = 1e3 * (tooth_m[:, 2].min() - SUCCESS_Z_RANGE_M[0]) - _LIFT_MARGIN_MM
    return _in_proportion(np.array([inwards_mm, down_mm]), np.array(LockOpeningSettings().action_scale_mm))


def _in_proportion(way: NDArray[np.float64], scale: NDArray[np.float64]) -> ActionArray:
    """Return the longest action along a way that does not go beyond its end."""
    action = way / scale
    return np.asarray(action / max(1.0, float(np.abs(action).max())), dtype=np.float32)
