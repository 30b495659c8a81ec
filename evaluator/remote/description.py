"""What submission.yaml says of a policy server: its protocol, and how observations are named for it."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any, Final, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from ..strict_model import StrictModel

DIALS_IN: Final = "connect"
"""In place of an address: the policy dials the service."""
_Length = Annotated[int, Field(ge=1, le=1024)]


class RemoteProtocol(StrEnum):
    """What a policy server speaks."""

    OPENPI = "openpi"
    """A server of openpi: we dial it, it answers each observation with actions."""
    VLA_EVAL = "vla-eval"
    """A model server of vla-eval: we dial it, it hears of the start and the end of each episode."""
    ROBOT_BRIDGE = "robot-bridge"
    """A policy of the 2026 edition: it dials us, as it dials the robot."""
    LEROBOT = "lerobot"
    """LeRobot's server of policies: we dial it, it loads the policy that it is given."""

    @property
    def has_one_client(self) -> bool:
        """Whether a server answers one client at a time: another one's questions would take its answers."""
        return self is RemoteProtocol.LEROBOT


class LeRobotPolicy(StrictModel):
    """Section `policy`: what a server of LeRobot loads."""

    type: Annotated[str, Field(min_length=1, max_length=80, description="LeRobot's name of the kind, such as act.")]
    path: Annotated[
        str,
        Field(min_length=1, max_length=300, description="Folder on the server's machine, or name at its model hub."),
    ]
    device: Annotated[str, Field(min_length=1, max_length=80, description="Where it computes, such as cuda.")] = "cpu"


class SentValue(StrictModel):
    """Which value of the observation is sent under a name of the server's."""

    key: Annotated[str, Field(min_length=1, max_length=80, description="Key of the observation.")]
    size: Annotated[
        tuple[_Length, _Length] | None,
        Field(description="Height and width of a picture, which is resized."),
    ] = None

    def of(self, observation: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        """Return the value."""
        value = observation[self.key]
        return value if self.size is None else resize(value, self.size)


def _as_key(value: object) -> object:
    return {"key": value} if isinstance(value, str) else value


class RemoteServer(StrictModel):
    """Section `remote` of submission.yaml."""

    protocol: Annotated[RemoteProtocol, Field(description="openpi, vla-eval, robot-bridge or lerobot.")]
    observations: Annotated[
        dict[
            Annotated[str, Field(min_length=1, max_length=80)],
            Annotated[SentValue, BeforeValidator(_as_key)],
        ]
        | None,
        Field(min_length=1, max_length=64, description="What is sent, by the server's name for it; all by default."),
    ] = None
    policy: Annotated[LeRobotPolicy | None, Field(description="What a server of lerobot loads.")] = None
    address: Annotated[
        str | None,
        Field(
            max_length=300,
            description="Where a service asks it, such as ws://policy.example.org:8000; connect: it dials in.",
        ),
    ] = None
    prompt: Annotated[str, Field(max_length=500, description="The task in words; the task's name by default.")] = ""
    execute: Annotated[
        int, Field(ge=1, le=1000, description="How many actions of an answer are played before the next question.")
    ] = 1

    @model_validator(mode="after")
    def _check_policy(self) -> Self:
        is_lerobot = self.protocol is RemoteProtocol.LEROBOT
        if is_lerobot and self.policy is None:
            raise ValueError("lerobot needs a section `policy`, which says what its server loads")
        if not is_lerobot and self.policy is not None:
            raise ValueError(f"a section `policy` is for lerobot alone; {self.protocol} serves what it has")
        return self

    @property
    def keys(self) -> tuple[str, ...] | None:
        """Keys of the observation that are sent; None for all."""
        if self.observations is None:
            return None
        return tuple(dict.fromkeys(value.key for value in self.observations.values()))

    def names(self, observation: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return an observation as the server names it; what is of another task is left out."""
        if self.observations is None:
            return dict(observation)
        return {name: value.of(observation) for name, value in self.observations.items() if value.key in observation}


def by_level(named: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Return values in maps of maps, where a slash in a name makes a level: `images/wrist`."""
    levels: dict[str, Any] = {}
    for name, value in named.items():
        level, _, inner = name.rpartition("/")
        (levels.setdefault(level, {}) if level else levels)[inner] = value
    return levels


def resize(picture: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Return a picture in another size: the mean of the pixels below each new one, or the nearest where it grows.

    Args:
        picture: shape [height, width, ...], of any numeric type; a picture of depths takes the nearest pixel.
        size: height and width of the new one.
    """
    if picture.dtype != np.uint8:
        rows, columns = (_nearest(old, new) for old, new in zip(picture.shape[:2], size, strict=True))
        return picture[rows[:, None], columns]
    mean = picture.astype(np.float32)
    for axis, (old, new) in enumerate(zip(picture.shape[:2], size, strict=True)):
        mean = np.moveaxis(np.tensordot(_weights(old, new), mean, axes=(1, axis)), 0, axis)
    return np.rint(mean).astype(np.uint8)


def _nearest(old: int, new: int) -> NDArray[np.intp]:
    return ((np.arange(new) + 0.5) * old / new).astype(np.intp)


def _weights(old: int, new: int) -> NDArray[np.float32]:
    """Return what share each old pixel has in each new one, shape [new, old]."""
    edges = np.arange(new + 1) * old / new
    overlap = np.minimum(edges[1:, None], np.arange(1, old + 1)) - np.maximum(edges[:-1, None], np.arange(old))
    share: NDArray[np.float64] = np.maximum(overlap, 0.0)
    return np.asarray(share / share.sum(axis=1, keepdims=True), np.float32)
