"""What can be observed of a scene, as objects: a task lists them; space, tables and reading follow from the list."""

import hashlib
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
class Curves:
    """Curves over an episode that show an observable in plots and in the 3D player.

    Attributes:
        title: of the plot, with the unit.
        names: of the curves.
        read: gives a number for each of them from the value of the observable.
    """

    title: str
    names: tuple[str, ...]
    read: Callable[[NDArray[Any]], NDArray[Any]] = np.ravel


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
        curves: how it is plotted. What has any is read without the episode's generator (`noise_digest`), and is in the
            info of every env step by its name, so that records have it and measures may be read from it, whatever a
            policy observes.
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
    curves: tuple[Curves, ...] = ()
    node_axis: int | None = None

    def with_nodes(self, count: int) -> "Observable[SceneT]":
        """Return the same observable of a gel with this number of sensing nodes."""
        if self.node_axis is None:
            return self
        shape = (*self.shape[: self.node_axis], count, *self.shape[self.node_axis + 1 :])
        return replace(self, shape=shape)


def noise_digest(random: np.random.Generator, stream: int, content: bytes) -> bytes:
    """Return 32 bytes for the noise of a reading, from the episode's seed and from what is read; nothing is drawn.

    So a reading is the same whatever else is observed, and however often.

    Args:
        random: the episode's generator.
        stream: number of the kind of sensor.
        content: what is read, and when.
    """
    seed: Any = random.bit_generator.seed_seq
    child = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, stream))
    return hashlib.sha256(child.generate_state(4).astype("<u4").tobytes() + content).digest()
