"""ManiSkill's environments as tasks, as the catalogue describes them; light to import."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from vitac.errors import VitacError

from ..observable import Observable
from ..tasks.definition import ActionComponent, Family, TaskDefinition
from ..tasks.settings import nearest, read_task_settings

CATALOGUE_FILE = Path(__file__).with_name("catalogue.yaml")
"""Written by `describing`."""

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""In C where PyYAML has it: every command that looks for a task reads the file."""

MODES = ("state", "rgb", "rgbd", "pointcloud")
"""The `obs_mode` that a task may have."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One key of an observation, without the batch dimension."""

    name: str
    shape: tuple[int, ...]
    dtype: str


@dataclass(frozen=True, kw_only=True)
class Described:
    """An environment that can be a task.

    Attributes:
        robot: ManiSkill's name of it.
        control_modes: size of an action in each control mode whose actions are in [-1, 1].
        state: names and sizes of the parts of the state vector, in order.
        pictures: the keys of each observation mode with cameras.
    """

    robot: str
    control_modes: Mapping[str, int]
    state: tuple[tuple[str, int], ...]
    pictures: Mapping[str, tuple[Entry, ...]]


@dataclass(frozen=True, kw_only=True)
class Catalogue:
    """All environments that were tried.

    Attributes:
        made_with: versions of the packages that they were tried with.
        environments: those that can be tasks, by ManiSkill's id.
        refused: why the others cannot, by ManiSkill's id.
    """

    made_with: Mapping[str, str]
    environments: Mapping[str, Described]
    refused: Mapping[str, str]


@cache
def catalogue() -> Catalogue:
    """Return what is known of all environments that were tried."""
    content = yaml.load(CATALOGUE_FILE.read_text(encoding="utf-8"), Loader=_LOADER)  # noqa: S506 - a safe one
    return Catalogue(
        made_with=content["made_with"],
        environments={env_id: _read_described(entry) for env_id, entry in content["environments"].items()},
        refused=content["refused"],
    )


def _read_described(entry: Mapping[str, Any]) -> Described:
    observations = entry["observations"]
    return Described(
        robot=entry["robot"],
        control_modes=entry["control_modes"],
        state=tuple(_part(line) for line in observations["state"]),
        pictures={mode: tuple(_entry(line) for line in observations[mode]) for mode in MODES[1:]},
    )


def _part(line: str) -> tuple[str, int]:
    """Return name and size from a line such as `agent_qpos 9`."""
    name, size = line.split()
    return name, int(size)


def _entry(line: str) -> Entry:
    """Return the key that a line such as `base_camera_rgb uint8 128x128x3` describes."""
    name, dtype, shape = line.split()
    return Entry(name=name, dtype=dtype, shape=tuple(int(size) for size in shape.split("x")))


PREFIX = "ManiSkill/"
"""Prefix of the `env_id` in a track file; ManiSkill's own id follows."""

CPU, CUDA = "physx_cpu", "physx_cuda"
MAX_BATCH_SIZE = 64
"""Each episode of a batch has a policy of its own in memory, and one of the users that a process has for policies."""

_MADE_OF_DRAWN_SHAPES = frozenset({"PushT-v1"})
"""Environments that look at their drawn shapes when they are made."""
_ENVIRONMENT = "vitac.envs.maniskill.env:ManiSkillEnv"


class ManiSkillTaskRejected(VitacError):
    """A track file names a ManiSkill environment or a mode that cannot be a task; the message says what can."""


@dataclass(frozen=True, kw_only=True)
class ManiSkillSettings:
    """What a track file says of a ManiSkill task, as its `settings`.

    Attributes:
        obs_mode: what is observed: `state`, `rgb`, `rgbd` or `pointcloud`.
        control_mode: what an action moves, by ManiSkill's name.
        success_key: entry of ManiSkill's info that says whether the task is solved.
        sim_backend: where the physics runs: `physx_cpu`, or `physx_cuda` on a GPU, which does not repeat.
        batch_size: number of episodes that are played at once, each in a scene of its own of one simulation; more
            than one on a GPU only.
    """

    obs_mode: str = "state"
    control_mode: str = "pd_ee_delta_pose"
    success_key: str = "success"
    sim_backend: str = CPU
    batch_size: int = 1


def is_maniskill(env_id: str) -> bool:
    """Return whether the environment is one of ManiSkill's."""
    return env_id.startswith(PREFIX)


def find_definition(env_id: str, settings: Mapping[str, Any]) -> TaskDefinition:
    """Return the task of an environment, from the catalogue; ManiSkill need not be installed.

    Raises:
        ManiSkillTaskRejected: the environment is unknown or cannot be a task, or a mode is not one of its own.
        SettingsError: a setting is unknown or of a wrong type.
    """
    chosen = read_task_settings(ManiSkillSettings, dict(settings))
    described = _described(env_id)
    return TaskDefinition(
        env_id=env_id,
        environment=_ENVIRONMENT,
        actions=_actions(env_id, described, chosen.control_mode),
        observables=_observables(env_id, described, chosen.obs_mode),
        family=_family(env_id, chosen),
        control_mode=chosen.control_mode,
        repeats=chosen.sim_backend == CPU,
        pictures_repeat=chosen.obs_mode == "state",
        batch_size=_batch_size(env_id, chosen),
    )


def _family(env_id: str, chosen: ManiSkillSettings) -> Family:
    if chosen.sim_backend not in {CPU, CUDA}:
        raise ManiSkillTaskRejected(f"{env_id}: sim_backend is {chosen.sim_backend!r}, expected {CPU} or {CUDA}.")
    if chosen.sim_backend == CUDA:
        return Family.MANISKILL_CUDA
    return Family.MANISKILL_PICTURES if needs_driver(env_id, chosen) else Family.MANISKILL


def _batch_size(env_id: str, chosen: ManiSkillSettings) -> int:
    largest = MAX_BATCH_SIZE if chosen.sim_backend == CUDA else 1
    if not 1 <= chosen.batch_size <= largest:
        expected = f"1 to {largest}" if largest > 1 else f"1: only {CUDA} moves several scenes at once"
        raise ManiSkillTaskRejected(f"{env_id}: batch_size is {chosen.batch_size}, expected {expected}.")
    return chosen.batch_size


def needs_driver(env_id: str, chosen: ManiSkillSettings) -> bool:
    """Return whether an environment needs a Vulkan driver: for its pictures, or to be made at all."""
    return chosen.obs_mode != "state" or env_id.removeprefix(PREFIX) in _MADE_OF_DRAWN_SHAPES


def _described(env_id: str) -> Described:
    known, name = catalogue(), env_id.removeprefix(PREFIX)
    if name in known.environments:
        return known.environments[name]
    if name in known.refused:
        raise ManiSkillTaskRejected(f"{env_id} cannot be a task. {known.refused[name]}")
    raise ManiSkillTaskRejected(f"There is no {env_id}; {nearest(name, list(known.environments))}")


def _actions(env_id: str, described: Described, control_mode: str) -> tuple[ActionComponent, ...]:
    if control_mode not in described.control_modes:
        modes = ", ".join(described.control_modes)
        raise ManiSkillTaskRejected(
            f"{env_id} has no control mode {control_mode!r} with actions in [-1, 1]; expected one of {modes}."
        )
    size = described.control_modes[control_mode]
    named = _PANDA_ACTIONS.get(control_mode.replace("_target_", "_"), ()) if "panda" in described.robot else ()
    if len(named) == size:
        return named
    return tuple(
        ActionComponent(name=f"action_{index}", scale=1.0, unit="1", meaning=f"Number {index} of `{control_mode}`.")
        for index in range(size)
    )


def _observables(env_id: str, described: Described, obs_mode: str) -> tuple[Observable[Any], ...]:
    if obs_mode not in MODES:
        raise ManiSkillTaskRejected(f"{env_id}: obs_mode is {obs_mode!r}, expected one of {', '.join(MODES)}.")
    if obs_mode == "state":
        return (_state(described),)
    return tuple(
        _observable(entry.name, entry.shape, entry.dtype, f"As ManiSkill's `{obs_mode}` observation has it.")
        for entry in described.pictures[obs_mode]
    )


def _state(described: Described) -> Observable[Any]:
    parts, begin = [], 0
    for name, size in described.state:
        numbers = str(begin) if size == 1 else f"{begin} to {begin + size - 1}"
        unit = _UNITS.get(name.rpartition("_")[2])
        parts.append(f"{numbers} {name}" + (f" [{unit}]" if unit else ""))
        begin += size
    return _observable("state", (begin,), "float32", f"ManiSkill's state vector: {', '.join(parts)}.")


def _observable(name: str, shape: tuple[int, ...], dtype: str, meaning: str) -> Observable[Any]:
    """Return an entry that the adapter fills; read by name from a ManiSkill observation."""
    return Observable(
        name=name, shape=shape, unit="SI", meaning=meaning, dtype=dtype, read=lambda observation, _: observation[name]
    )


_UNITS = {
    "qpos": "rad; m of sliding joints",
    "qvel": "rad/s; m/s of sliding joints",
    "pose": "position in m, quaternion wxyz",
    "poses": "position in m, quaternion wxyz, of each",
    "pos": "m",
    "p": "m",
    "size": "m",
    "radius": "m",
    "vertices": "m",
    "vel": "m/s",
    "q": "quaternion wxyz",
}
"""Unit of a part of the state vector by the last word of its name, where that says it."""

_GRIPPER = ActionComponent(name="gripper", scale=1.0, unit="1", meaning="1 opens the gripper, -1 closes it.")
_POSITION = tuple(
    ActionComponent(name=axis, scale=0.1, unit="m", meaning=f"Motion of the gripper's middle along {axis} of the base.")
    for axis in "xyz"
)
_ROTATION = tuple(
    ActionComponent(
        name=f"r{axis}",
        scale=-0.1,
        unit="rad",
        meaning=f"Angle about {axis} of the base, against its sign; of the three, the length is at most 1.",
    )
    for axis in "xyz"
)
_JOINTS = tuple(
    ActionComponent(name=f"joint_{number}", scale=0.1, unit="rad", meaning=f"Motion of joint {number} of the arm.")
    for number in range(1, 8)
)
# ManiSkill's agents/robots/panda/panda.py; "target" modes move what was commanded before, not what was measured.
_PANDA_ACTIONS: Mapping[str, tuple[ActionComponent, ...]] = {
    "pd_joint_delta_pos": (*_JOINTS, _GRIPPER),
    "pd_ee_delta_pos": (*_POSITION, _GRIPPER),
    "pd_ee_delta_pose": (*_POSITION, *_ROTATION, _GRIPPER),
}
