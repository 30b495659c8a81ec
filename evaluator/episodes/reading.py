"""Which keys of a task's observation a policy reads, and which of them are computed and sent; called by `shards`."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray
from vitac.envs.observable import Observable
from vitac.envs.tasks.definition import chosen_observables

from ..agent.protocol.frames import CloudSpec

Observation = Mapping[str, NDArray[Any]]


class Observed(Protocol):
    """What says which observables a policy may read: a task of a track."""

    @property
    def observables(self) -> tuple[Observable[Any], ...]:
        """Nothing privileged is among them."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """The part of an observation that reaches a policy.

    A point cloud follows from its depth picture, so the picture is sent and the policy's side makes the cloud of it.

    Attributes:
        keys: what the policy reads, in the order of the task.
        sent: what the environment computes and what is sent.
        clouds: what the policy's side makes of what was sent.
    """

    keys: tuple[str, ...]
    sent: tuple[str, ...]
    clouds: tuple[CloudSpec, ...]


def make_reading(task: Observed, keys: Collection[str] | None = None) -> Reading:
    """Return what a policy reads that names these keys; keys that are another task's are left out.

    Args:
        task: what is played.
        keys: from the submission manifest; None for all of the task's.
    """
    listed = task.observables
    read = listed if keys is None else tuple(entry for entry in listed if entry.name in keys)
    names = {entry.name for entry in read}
    clouds = [
        CloudSpec(
            name=entry.name,
            depth=entry.computed_from.depth,
            keep_depth=entry.computed_from.depth in names,
            intrinsics=list(entry.computed_from.intrinsics),
        )
        for entry in read
        if entry.computed_from
    ]
    sent = {entry.name for entry in read if not entry.computed_from} | {cloud.depth for cloud in clouds}
    return Reading(
        keys=tuple(entry.name for entry in read),
        sent=tuple(entry.name for entry in chosen_observables(listed, sent)),
        clouds=tuple(clouds),
    )
