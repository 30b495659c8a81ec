"""Counts what one client may do: events in a time window, and things at the same time. Kept in this process only."""

import threading
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from vitac.server.errors import ProblemCode, ServiceError


class WindowLimiter:
    """At most `limit` events for a key within `window_s` seconds."""

    def __init__(self, *, limit: int, window_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._limit = limit
        self._window_s = window_s
        self._clock = clock
        self._events: defaultdict[str, deque[float]] = defaultdict(deque)
        self._lock = threading.Lock()

    def note(self, key: str, what: str) -> None:
        """Count one event.

        Raises:
            ServiceError: too many; `retry_after_s` says when the next one is possible.
        """
        now = self._clock()
        with self._lock:
            self._forget(now)
            events = self._events[key]
            if len(events) >= self._limit:
                wait_s = max(1, round(events[0] + self._window_s - now))
                raise ServiceError(
                    ProblemCode.TOO_MANY_REQUESTS,
                    f"At most {self._limit} {what} in {self._window_s:.0f} s are possible; wait {wait_s} s.",
                    retry_after_s=wait_s,
                )
            events.append(now)

    def _forget(self, now: float) -> None:
        for key in list(self._events):
            events = self._events[key]
            while events and events[0] <= now - self._window_s:
                events.popleft()
            if not events:
                del self._events[key]


class ConcurrencyLimiter:
    """At most `limit` things of a key at the same time."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._running: Counter[str] = Counter()
        self._lock = threading.Lock()

    @contextmanager
    def one(self, key: str, what: str) -> Iterator[None]:
        """Count one thing while the block runs.

        Raises:
            ServiceError: as many as possible are running.
        """
        with self._lock:
            if self._running[key] >= self._limit:
                raise ServiceError(
                    ProblemCode.TOO_MANY_REQUESTS, f"At most {self._limit} {what} are possible; wait for one to end."
                )
            self._running[key] += 1
        try:
            yield
        finally:
            with self._lock:
                self._running[key] -= 1
                if not self._running[key]:
                    del self._running[key]
