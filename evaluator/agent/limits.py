"""Every limit on a submission in one place, and the times of a shard and its episodes that are counted against them.

Limits are shown in the rules, stored with the result, and changed by settings only.
"""

import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, fields

from vitac.errors import VitacError

from .verdicts import PolicyFailed, SandboxFailed, VerdictCode

KIB = 1024
MIB = 1024 * KIB
GIB = 1024 * MIB


class LimitsInvalid(VitacError):
    """A limit is not a positive number: correct the setting that the message names."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What one submission may use; sizes in bytes, times in seconds."""

    memory_bytes: int = 3 * GIB
    """Memory of the policy and its children together (memory cgroup, else the watchdog)."""
    address_space_bytes: int = 4 * GIB
    """Address space of each process."""
    processes: int = 64
    """Processes and threads together."""
    open_files: int = 256
    file_size_bytes: int = 64 * MIB
    """Size of one written file."""
    tmp_bytes: int = 64 * MIB
    shm_bytes: int = 16 * MIB

    start_cpu_s: float = 60.0
    """Import and constructor."""
    start_wall_s: float = 120.0
    action_cpu_s: float = 2.0
    """One answer: an action, or the end of reset()."""
    action_wall_s: float = 10.0
    episode_cpu_s: float = 30.0
    shard_cpu_s: float = 300.0
    """All episodes of a shard together, with every load."""
    shard_wall_s: float = 900.0
    """Waiting for the policy in all episodes of a shard together, with every load."""

    output_kept_bytes: int = 64 * KIB
    """Length of the end of the policy's output that is stored for its team."""
    output_killed_bytes: int = 4 * MIB
    """Output of one start or one episode at which the policy is stopped."""

    archive_packed_bytes: int = 512 * MIB
    archive_unpacked_bytes: int = 1 * GIB
    archive_files: int = 5_000
    """Files and folders, with the folders that paths imply."""
    archive_depth: int = 16
    archive_ratio: float = 200.0
    """Unpacked over packed size."""

    image_bytes: int = 8 * GIB
    """A container image as a file, and all its layers unpacked."""
    image_files: int = 100_000
    """Files and folders in all its layers."""

    message_bytes: int = 16 * MIB
    """One message on the channel."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not value > 0:
                raise LimitsInvalid(f"Limit {field.name} is {value!r}, expected a number above 0; correct the setting.")


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


class StartTimes:
    """Starts episodes at times that follow from the first one's and not from how long the policy takes.

    Every policy can read the clock, so that an episode which ends at an instant of its choice tells the next one
    something. Where episodes start once in a period it tells nothing, as long as it ends within the period. One that
    does not doubles the period: so a policy can choose among few schedules, however long it takes (predictive
    mitigation of timing channels: Askarov, Zhang, Myers, CCS 2010, section 3).

    Args:
        period_s: from start to start [s]; 0: each episode starts as soon as it can.
    """

    def __init__(
        self,
        period_s: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.period_s = period_s
        self._clock = clock
        self._sleep = sleep
        self._last_s: float | None = None

    def wait(self) -> None:
        """Wait until the next episode may start."""
        now_s = self._clock()
        if not self.period_s or self._last_s is None:
            self._last_s = now_s
            return
        while self._last_s + self.period_s < now_s:
            self.period_s *= 2
        self._last_s += self.period_s
        self._sleep(self._last_s - now_s)


def default_period_s() -> float:
    """Return the period that VITAC_EPISODE_PERIOD_S names, 0 without it.

    Raises:
        SandboxFailed: it names none.
    """
    named = os.environ.get("VITAC_EPISODE_PERIOD_S") or "0"
    try:
        period_s = float(named)
    except ValueError:
        period_s = -1.0
    if not 0 <= period_s < math.inf:
        raise SandboxFailed(f"Expected VITAC_EPISODE_PERIOD_S to be a number of seconds from 0 on, got {named!r}.")
    return period_s
