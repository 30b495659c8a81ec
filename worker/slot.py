"""Places for simulations on this machine: how many run at once, and when the next one may come; used by `worker`."""

import threading
from collections.abc import Callable


class Slot:
    """A place for one simulation.

    Its work may leave it before it is over, with the result still to be stored, and may say some moments before that
    it soon will: the next work can be fetched meanwhile.

    Args:
        free: counts the places that are free; one of its own by default.
        soon: called once, in the thread of the work, when the slot will soon be free.
    """

    def __init__(self, free: threading.Semaphore | None = None, soon: Callable[[], object] = lambda: None) -> None:
        self._free = free or threading.Semaphore()
        self._soon = soon
        self._is_said = False
        self._is_held = False

    def hold(self, work: Callable[[], None]) -> None:
        """Wait until a place is free and do work in it; the place is free again at its end at the latest."""
        self._free.acquire()
        self._is_held = True
        try:
            work()
        finally:
            self._give_back()

    def soon_left(self) -> None:
        """Say that the work will leave within moments."""
        if not self._is_said:
            self._is_said = True
            self._soon()

    def leave(self) -> None:
        """Let another simulation have the place; called by the work, which continues."""
        self._give_back()
        self.soon_left()

    def _give_back(self) -> None:
        if self._is_held:
            self._is_held = False
            self._free.release()
