"""Waits for Ctrl-C or SIGTERM. Called by `serve` and `demo`."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SUPERVISION_PERIOD_S = 0.5


class Interrupted(Exception):
    """A request to stop was received before the work was done."""


class StopRequest:
    """A request to stop, by Ctrl-C or SIGTERM. A second signal ends the process at once."""

    def __init__(self) -> None:
        self._received = threading.Event()

    @contextmanager
    def listening(self) -> Iterator["StopRequest"]:
        """Handle the two signals inside the block; restore the previous handlers after it."""
        numbers = (signal.SIGINT, signal.SIGTERM)
        before = {number: signal.signal(number, self._handle) for number in numbers}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @property
    def received(self) -> bool:
        """Whether a signal was received."""
        return self._received.is_set()

    def wait(self, timeout_s: float) -> bool:
        """Wait for the request for at most `timeout_s`; return whether it was received."""
        return self._received.wait(timeout_s)

    def supervise(self, restart_ended: Callable[[], object]) -> None:
        """Restart processes that end, until the request is received."""
        while not self.wait(SUPERVISION_PERIOD_S):
            restart_ended()

    def _handle(self, number: int, _frame: object) -> None:
        if self.received:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        self._received.set()
