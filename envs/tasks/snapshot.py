"""The state of a running episode, kept so that it can be continued from there more than once."""

from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..scene.grasped_scene import GraspState


@dataclass(frozen=True, kw_only=True, eq=False)
class Generators:
    """The random numbers that are to come.

    Attributes:
        own: generator of the environment.
        episode: generator of the episode; None where it is the environment's own.
    """

    own: np.random.Generator
    episode: np.random.Generator | None

    def copied(self) -> "Generators":
        """Return generators that give the same numbers without changing what these give."""
        return deepcopy(self)


@dataclass(frozen=True, kw_only=True, eq=False)
class EpisodeSnapshot:
    """What `restore` needs; it belongs to the environment that made it and to no other process.

    Attributes:
        scene: of the episode; it is shared by all snapshots of the episode and built again by none.
        commanded: what was commanded so far and what else the task's scene keeps, beside the physics.
        grasp: state of the physics, the gripper and the sensors.
        error: how far the episode was from its goal.
        generators: as they were.
    """

    scene: Any
    commanded: dict[str, Any]
    grasp: GraspState
    error: float
    generators: Generators
