"""What is known of ManiSkill's environments without having it installed: read from `catalogue.yaml`."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

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
        environments={env_id: _described(entry) for env_id, entry in content["environments"].items()},
        refused=content["refused"],
    )


def _described(entry: Mapping[str, Any]) -> Described:
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
