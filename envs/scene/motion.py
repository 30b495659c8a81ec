"""How many IPC steps a motion of the gripper takes (challenge-facts 3). Used by every task."""

from ..errors import VitacError


class MotionError(VitacError):
    """A motion cannot be divided into IPC steps; the message names the value."""


def ipc_steps(amount: float, *, speed_per_s: float, time_step_s: float) -> int:
    """Return the IPC steps for a motion at a speed: the nearest whole number, ties to even, at least 1.

    The published text rounds up; the 2025 code, which the logs follow, rounds to the nearest [D1].

    Args:
        amount: length [m] or angle [rad]; its sign does not matter.
        speed_per_s: [m/s] or [rad/s].
        time_step_s: length of an IPC step [s].
    """
    if not (speed_per_s > 0 and time_step_s > 0):
        raise MotionError(f"Speed and time step must be positive, got {speed_per_s} 1/s and {time_step_s} s.")
    return max(1, round(abs(amount) / speed_per_s / time_step_s))
