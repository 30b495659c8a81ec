"""How long a worker takes work: by default until a request to stop, shorter where a scheduler lends the machine."""

import time
from dataclasses import dataclass, field

from vitac.envs.errors import VitacError

ONCE_WAITS_S = 10.0
"""How long a worker that takes one piece of work waits for it [s]."""


class WorkerRefused(VitacError):
    """A worker with a limited stay may take no shards on this machine; waiting would only cost the time lent to it."""


@dataclass(frozen=True, kw_only=True)
class Stay:
    """What ends a worker by itself, after the work that it has begun.

    Attributes:
        runs: shards and playbacks that it takes; None: any number.
        idle_s: time without work after which it ends [s]; None: it waits.
        lifetime_s: time from `began` after which it takes no more [s]; None: without limit.
        began: on the monotonic clock [s].
    """

    runs: int | None = None
    idle_s: float | None = None
    lifetime_s: float | None = None
    began: float = field(default_factory=time.monotonic, compare=False)

    @property
    def is_limited(self) -> bool:
        """Whether anything but a request to stop ends it."""
        return self != UNLIMITED

    def is_over(self, *, taken: int, idle_s: float) -> bool:
        """Return whether a worker takes no more work.

        Args:
            taken: shards and playbacks that it has taken.
            idle_s: time since it had any [s].
        """
        pairs = ((taken, self.runs), (idle_s, self.idle_s), (time.monotonic() - self.began, self.lifetime_s))
        return any(limit is not None and value >= limit for value, limit in pairs)


UNLIMITED = Stay()
