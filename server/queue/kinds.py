"""What follows from the kind of a piece of work: the one place that says it; asked by claims, leases and the sweep."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from ..database.states import WorkKind


@dataclass(frozen=True, kw_only=True)
class Kind:
    """How work of a kind is shared out, and what it may take.

    Attributes:
        priority: the lowest of what waits goes first.
        share: part of the time of all slots up to which it goes by its priority; what is over its share goes after
            all others. None: without limit.
        one_per_owner: whether only one piece of an owner runs at a time (`uq_work_place` holds it).
        limit_s: time of one attempt [s]; None: as long as it progresses.
        free_repeats: how many attempts do not count that a lost worker or a broken machine ended.
    """

    priority: int
    share: float | None = None
    one_per_owner: bool = False
    limit_s: float | None = None
    free_repeats: int = 0


KINDS: Mapping[WorkKind, Kind] = MappingProxyType(
    {
        WorkKind.SENSOR_CHECK: Kind(priority=1, share=0.25, one_per_owner=True, limit_s=60.0),
        WorkKind.REPLAY: Kind(priority=2, share=0.1, limit_s=1800.0),
        WorkKind.PLAYBACK: Kind(priority=3, share=0.25, limit_s=600.0),
        # A killed agent or a device with a fault says nothing about the policy.
        WorkKind.TRIAL: Kind(priority=4, free_repeats=20),
        WorkKind.SHARD: Kind(priority=5),
    }
)
"""Every kind. Short work that people wait for goes first, within its share; evaluations have the rest, at least 0.4."""
