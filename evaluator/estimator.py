"""The standard estimator: what it reads from a marker flow, its fixed controller, and its calibration to a sensor.

It is calibrated at starts that no evaluation plays, and plays in our own process, because nothing of a team's runs in
it. The controller weighs each regression's estimate by its variance, and moves the offset away.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import radians
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from .agent.protocol import CloudSpec
from .episodes.episode import Environment, make_environment
from .regression import Coefficients, fit, normal_equations, solve
from .sensors.made import read_design
from .tracks import Task

if TYPE_CHECKING:
    from .episodes.records import Observation

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
        predicted = regression.predict(append_motion(features, self._last_motion, self._scale))
        if self._estimate is None:
            self._variances = list(regression.variances)
            return predicted
        estimate = []
        for axis, (old, new) in enumerate(zip(self._estimate, predicted, strict=True)):
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


# Half the picture, by which positions are scaled.
_HALF_U_PX, _HALF_V_PX = 160.0, 120.0
# Keeps the field defined where few markers are seen, or all on one line.
_RIDGE = 0.1
_TERMS = 6
COUNT = 2 * 2 * _TERMS
"""Two sensors, two directions, six terms."""


def compute_features(marker_flow: NDArray[np.float32], *, at_rest: bool = False) -> list[float]:
    """Return the coefficients of the motion of the markers in both pictures [pixel].

    In each picture, motion is fitted by the terms 1, x, y, x^2, x y, y^2 of the reference position, which is 0 in the
    middle and 1 at the rim; first all terms of u, then of v; first the left sensor.

    Args:
        marker_flow: shape [2, 2, m, 2] [pixel]; the last marker may be repeated to fill it.
        at_rest: all markers are where they were in the reference.
    """
    if at_rest:
        return [0.0] * COUNT
    return [value for flow in marker_flow.astype(np.float64) for value in _field(*_distinct(flow))]


def _distinct(flow: NDArray[np.float64]) -> tuple[list[list[float]], list[list[float]]]:
    """Return reference and current positions without the repeats of the last marker."""
    repeats = (flow == flow[:, -1:]).all(axis=(0, 2))
    count = int(repeats.argmax()) + 1
    reference, current = flow[:, :count].tolist()
    return reference, current


def _field(reference: list[list[float]], current: list[list[float]]) -> list[float]:
    rows, motions = [], []
    for (u, v), (u_now, v_now) in zip(reference, current, strict=True):
        x, y = (u - _HALF_U_PX) / _HALF_U_PX, (v - _HALF_V_PX) / _HALF_V_PX
        rows.append((1.0, x, y, x * x, x * y, y * y))
        motions.append((u_now - u, v_now - v))
    squares, products = normal_equations(rows, motions)
    for term in range(_TERMS):
        squares[term][term] += _RIDGE
    coefficients = solve(squares, products)
    return [row[direction] for direction in range(2) for row in coefficients]


SEED: Final = 20_250_131
"""First number of the seed of every calibration start; lists of evaluations have other ones."""
STARTS: Final = 180
ENV_STEPS: Final = 4
"""Number of env steps with a regression of their own; later ones share the last."""
# Motions in the calibration remove a part of the true offset between these, and go this far beside it.
_PARTS = (0.3, 1.2)
_BESIDE = (1.7, 1.7, 3.5)

Sample = tuple[int, list[float], list[float]]
"""Env step, row of features, and the offset in the gripper's frame."""


def calibrate(
    env: Environment, task: Task, *, starts: int = STARTS, on_start: Callable[[int, int], None] = lambda *_: None
) -> Coefficients:
    """Return the coefficients of a sensor.

    The peg's shapes take turns. The environment draws each start from the seed (`SEED`, number) among those where the
    peg is blocked; motions come from a generator of that seed and 1.

    Args:
        env: of the task, with the sensor.
        task: a peg task; its own starts are not used.
        starts: number of episodes.
        on_start: gets how many episodes are played, after each, and of how many.
    """
    samples: list[list[tuple[list[float], list[float]]]] = [[] for _ in range(ENV_STEPS)]
    for number in range(starts):
        for env_step, row, target in _episode(env, task, number):
            samples[env_step].append((row, target))
        on_start(number + 1, starts)
    return Coefficients(
        mesh_hash=env.mesh_hash(),
        starts=starts,
        regressions=tuple(fit(*map(list, zip(*sample, strict=True))) for sample in samples if sample),
    )


_calibrated: dict[tuple[str, Path], Coefficients] = {}


def calibrated(task: Task, sensor: Path, on_start: Callable[[int, int], None] = lambda *_: None) -> Coefficients:
    """Return the coefficients of the sensor in a folder or file, calibrated once in a process and its copies."""
    key = task.env_id, sensor
    if key not in _calibrated:
        env = make_environment(task, sensor=read_design(sensor))
        _calibrated[key] = calibrate(env, task, on_start=on_start)
    return _calibrated[key]


def is_calibrated(task: Task, sensor: Path) -> bool:
    """Return whether this process has the coefficients of a sensor."""
    return (task.env_id, sensor) in _calibrated


def take(task: Task, sensor: Path, coefficients: Coefficients) -> None:
    """Use coefficients that another process has found for a sensor."""
    _calibrated[task.env_id, sensor] = coefficients


def _episode(env: Environment, task: Task, number: int) -> Iterator[Sample]:
    shapes, scale = task.episode_list.shapes, task.definition.action_scale
    random = np.random.Generator(np.random.PCG64([SEED, number, 1]))
    observation, info = env.reset(options={"shape": shapes[number % len(shapes)], "rng_seed": (SEED, number)})
    motion = [0.0] * len(scale)
    for env_step in range(ENV_STEPS):
        if info["end_reason"] is not None:
            return
        offset = rotate_to_gripper([float(value) for value in info["gt_offset_mm_deg"]])
        yield env_step, append_motion(compute_features(cast(Any, observation["marker_flow"])), motion, scale), offset
        if env_step == ENV_STEPS - 1:
            return
        action = _action(offset, scale, random)
        motion = [value * unit for value, unit in zip(action, scale, strict=True)]
        observation, _, _, _, info = env.step(np.array(action, dtype=np.float32))


def _action(offset: Vector, scale: Vector, random: np.random.Generator) -> list[float]:
    parts, beside = random.uniform(*_PARTS, len(scale)).tolist(), random.uniform(-1.0, 1.0, len(scale)).tolist()
    wanted = [
        -(part * value + side * width) for part, value, side, width in zip(parts, offset, beside, _BESIDE, strict=True)
    ]
    return [min(max(value / unit, -1.0), 1.0) for value, unit in zip(wanted, scale, strict=True)]


class EstimatorPolicy:
    """The estimator within one episode; attributes as `episodes.episode.PlayingPolicy` says."""

    channel_s = 0.0
    answers_s: tuple[float, ...] = ()
    output = ""

    def __init__(self, controller: Controller, *, is_blind: bool) -> None:
        self.cpu_s = 0.0
        self._controller = controller
        self._is_blind = is_blind

    def act(self, observation: "Observation") -> NDArray[np.float32]:
        """Return the action for an observation."""
        started = process_time()
        features = compute_features(cast(Any, observation["marker_flow"]), at_rest=self._is_blind)
        action = np.array(self._controller.act(features), dtype=np.float32)
        self.cpu_s += process_time() - started
        return action


class EstimatorSession:
    """The estimator, calibrated to a sensor, between episodes.

    Args:
        coefficients: of the sensor.
        action_scale: of the task [mm, mm, deg].
        is_blind: it sees all markers at rest.
    """

    isolation = None

    def __init__(self, coefficients: Coefficients, action_scale: Vector, *, is_blind: bool) -> None:
        self._coefficients = coefficients
        self._action_scale = action_scale
        self._is_blind = is_blind

    def begin_shard(self) -> None:
        """Count nothing: the estimator has no limit on its time."""

    @contextmanager
    def episode(
        self,
        *,
        task: str,  # noqa: ARG002 - as all sessions
        action_shape: tuple[int, ...],  # noqa: ARG002
        clouds: Sequence[CloudSpec] = (),  # noqa: ARG002
    ) -> Iterator[EstimatorPolicy]:
        """Return the estimator for one episode."""
        yield EstimatorPolicy(Controller(self._coefficients, self._action_scale), is_blind=self._is_blind)
