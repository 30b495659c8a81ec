"""When the episodes of a loaded policy start; called by `session`."""

import math
import os
import time
from collections.abc import Callable

from .verdicts import SandboxFailed


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
