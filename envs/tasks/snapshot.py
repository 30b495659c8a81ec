"""The state of a running episode, from which it can be continued more than once."""

from copy import deepcopy
from dataclasses import dataclass
from typing import Any, NoReturn

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
        owner: the environment that made it.
        scene: of the episode; it is shared by all snapshots of the episode and built again by none.
        commanded: what was commanded so far and what else the task's scene keeps, beside the physics.
        grasp: state of the physics, the gripper and the sensors.
        error: how far the episode was from its goal.
        drawn: quantities of the episode.
        generators: as they were.
    """

    owner: Any
    scene: Any
    commanded: dict[str, Any]
    grasp: GraspState
    error: float
    drawn: dict[str, float]
    generators: Generators

    def __reduce__(self) -> NoReturn:
        """Refuse to be pickled or copied, as the scene would come along.

        Raises:
            TypeError: always.
        """
        raise TypeError(
            "A snapshot cannot leave the process and the environment that made it. Send the seed and the actions "
            "instead, and play them again: the states are the same to the last bit."
        )
