"""The fixed controller: weighs each regression's estimate by its variance, and moves the offset away."""

from collections.abc import Sequence
from math import radians

from .regression import Coefficients

# How much less certain an estimate is after a motion [mm2, mm2, deg2].
_MOTION_VARIANCE = 0.05
Vector = Sequence[float]


class Controller:
    """Estimates the offset in the gripper's own frame over an episode, and answers with the motion that removes it.

    Args:
        coefficients: of the sensor.
        action_scale: motion at an action of 1 [mm, mm, deg].
    """

    def __init__(self, coefficients: Coefficients, action_scale: Vector) -> None:
        self._regressions = coefficients.regressions
        self._scale = action_scale
        self._env_steps = 0
        self._last_motion = [0.0] * len(action_scale)
        self._estimate: list[float] | None = None
        self._variances: list[float] = []

    def act(self, features: Vector) -> list[float]:
        """Return the action, in [-1, 1], for the features of the next observation."""
        estimate = self._updated(features)
        action = [min(max(-value / scale, -1.0), 1.0) for value, scale in zip(estimate, self._scale, strict=True)]
        self._last_motion = [value * scale for value, scale in zip(action, self._scale, strict=True)]
        self._estimate = move_offset(estimate, self._last_motion)
        self._env_steps += 1
        return action

    def _updated(self, features: Vector) -> list[float]:
        """Return the estimate, old and new weighed by their variances (a scalar Kalman filter for each axis)."""
        regression = self._regressions[min(self._env_steps, len(self._regressions) - 1)]
        found = regression.predict(append_motion(features, self._last_motion, self._scale))
        if self._estimate is None:
            self._variances = list(regression.variances)
            return found
        estimate = []
        for axis, (old, new) in enumerate(zip(self._estimate, found, strict=True)):
            before = self._variances[axis] + _MOTION_VARIANCE
            gain = before / (before + regression.variances[axis])
            self._variances[axis] = (1.0 - gain) * before
            estimate.append(old + gain * (new - old))
        return estimate


def append_motion(features: Vector, motion: Vector, scale: Vector) -> list[float]:
    """Return the features with the last motion behind them, 1 where it was the longest."""
    return [*features, *(value / unit for value, unit in zip(motion, scale, strict=True))]


def rotate_to_gripper(offset: Vector) -> list[float]:
    """Return an offset [mm, mm, deg] of the world's frame in that of the gripper."""
    x, y, theta_deg = offset
    return [*_turned(x, y, theta_deg), theta_deg]


def move_offset(offset: Vector, motion: Vector) -> list[float]:
    """Return an offset in the gripper's frame [mm, mm, deg] after a motion in that frame, in the new one."""
    x, y, theta_deg = (value + change for value, change in zip(offset, motion, strict=True))
    return [*_turned(x, y, motion[2]), theta_deg]


def _turned(x: float, y: float, angle_deg: float) -> tuple[float, float]:
    """Return x and y in a frame that is turned by an angle."""
    from vitac.envs.deterministic_math import sine_cosine

    sine, cosine = sine_cosine(radians(angle_deg))
    return cosine * x + sine * y, cosine * y - sine * x
