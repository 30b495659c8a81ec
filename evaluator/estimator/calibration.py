"""Calibrates the standard estimator to a sensor, at starts that no evaluation plays."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from ..episodes.episode import Environment, make_environment
from ..sensors.made import read_design
from ..tracks import Task
from .controller import Vector, append_motion, rotate_to_gripper
from .features import compute_features
from .regression import Coefficients, fit

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
        regressions=tuple(fit(*map(list, zip(*found, strict=True))) for found in samples if found),
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
        offset = rotate_to_gripper(_floats(info["gt_offset_mm_deg"]))
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


def _floats(values: Any) -> list[float]:
    return [float(value) for value in values]
