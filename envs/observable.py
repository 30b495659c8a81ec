"""What can be observed of a scene, as objects: a task lists them; space, tables and reading follow from the list."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

SceneT = TypeVar("SceneT")


@dataclass(frozen=True, kw_only=True)
class BackProjection:
    """How points follow from a depth picture (`vitac.envs.vision.pinhole`), so that only the picture is sent.

    Attributes:
        depth: key of the depth picture.
        intrinsics: of its camera: focal lengths and principal point in u and v [px].
    """

    depth: str
    intrinsics: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Observable(Generic[SceneT]):
    """One entry of an observation.

    Attributes:
        name: key of the observation.
        shape: of the array.
        unit: of its numbers.
        meaning: what they are, for tables.
        read: gives the value from the scene of the running episode; draws noise from the episode's generator only. What
            comes earlier in a list is read earlier.
        dtype: of the array; the value is converted to it.
        privileged: it is a truth that only training sees.
        computed_from: how it follows from another observable; None where it does not.
        picture: it is what a camera sees, read without the episode's generator; a record holds a hash of it.
        node_axis: axis that has an entry for every sensing node of a gel; None where there is none. `shape` has as many
            as the gel of the evaluations.
    """

    name: str
    shape: tuple[int, ...]
    unit: str
    meaning: str
    read: Callable[[SceneT, np.random.Generator], NDArray[Any]]
    dtype: str = "float32"
    privileged: bool = False
    computed_from: BackProjection | None = None
    picture: bool = False
    node_axis: int | None = None

    def with_nodes(self, count: int) -> "Observable[SceneT]":
        """Return the same observable of a gel with this number of sensing nodes."""
        if self.node_axis is None:
            return self
        shape = (*self.shape[: self.node_axis], count, *self.shape[self.node_axis + 1 :])
        return replace(self, shape=shape)
