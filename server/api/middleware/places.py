"""Places for requests at work, and what part of the processor's time each of them uses. Called by `shares`."""

import asyncio
import heapq
import itertools
import time
from collections.abc import Callable


class Places:
    """Places for requests at work: the lowest rank comes first, and of equal ones whoever has waited longest.

    Ranks are asked for again when a place is free: whoever sends many requests has a higher one with each.
    """

    def __init__(self, count: int) -> None:
        self._free = count
        self._turns = itertools.count()
        self._waiting: list[tuple[float, int, Callable[[], float], asyncio.Future[None]]] = []

    async def take(self, rank: Callable[[], float]) -> None:
        """Wait for a place."""
        if self._free:
            self._free -= 1
            return
        given = asyncio.get_running_loop().create_future()
        heapq.heappush(self._waiting, (rank(), next(self._turns), rank, given))
        try:
            await given
        except asyncio.CancelledError:
            if not given.cancelled():  # it was given one, and nobody will use it
                self.leave()
            raise

    def leave(self) -> None:
        """Give a place to the next."""
        while self._waiting:
            _, turn, rank, given = heapq.heappop(self._waiting)
            if given.done():
                continue
            now = rank(), turn, rank, given
            if self._waiting and now[:2] > self._waiting[0][:2]:
                heapq.heappush(self._waiting, now)
                continue
            given.set_result(None)
            return
        self._free += 1


class SharedTime:
    """Tells what part of the process's processor time belongs to a request: at each moment all at work share it."""

    def __init__(self, clock: Callable[[], float] = time.process_time) -> None:
        self._clock = clock
        self._at_work = 0
        self._of_one_s, self._at_s = 0.0, clock()

    def begin(self) -> float:
        """Note that a request begins; return what `end` wants to know."""
        self._advance()
        self._at_work += 1
        return self._of_one_s

    def end(self, begun_s: float) -> float:
        """Note that a request ends; return its part [s]."""
        self._advance()
        self._at_work -= 1
        return self._of_one_s - begun_s

    def _advance(self) -> None:
        now_s = self._clock()
        if self._at_work:
            self._of_one_s += (now_s - self._at_s) / self._at_work
        self._at_s = now_s
