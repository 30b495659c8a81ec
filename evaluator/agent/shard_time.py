"""The time that a policy has used over all episodes of its shard; a session counts it and stops where it is used up.

The limits on one answer and on one episode alone would let a policy keep a worker busy for hours.
"""

from .limits import Limits
from .verdicts import PolicyFailed, VerdictCode


class ShardTime:
    """What the policy of a session has used so far [s]; counted from zero when a shard is resumed."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self.cpu_s = 0.0
        """CPU time of all its processes, loading included."""
        self.wall_s = 0.0
        """Wall time spent waiting for it."""

    def check(self) -> None:
        """Make sure that there is time left for another question.

        Raises:
            PolicyFailed: shard_time.
        """
        if self.cpu_s > self._limits.shard_cpu_s:
            raise _time_spent(f"used more than {self._limits.shard_cpu_s:g} s of CPU time")
        if self.wall_s > self._limits.shard_wall_s:
            raise _time_spent(f"were waited for longer than {self._limits.shard_wall_s:g} s")


def _time_spent(how: str) -> PolicyFailed:
    return PolicyFailed(VerdictCode.SHARD_TIME, f"Loading and all episodes of the shard together {how}.")
