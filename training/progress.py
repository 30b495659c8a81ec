"""Estimates how long work still takes from how long it took so far; shown to people, and nothing depends on it."""

from collections.abc import Callable
from time import monotonic


class TrainingProgress:
    """Work of equal parts, of which some may have been done before.

    Args:
        clock: gives the time [s].
    """

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._clock = clock
        self._began: tuple[int, float] | None = None

    def begin(self, done: int) -> None:
        """Begin to measure after this number of parts, which were done before."""
        self._began = (done, self._clock())

    def left(self, done: int, total: int) -> str:
        """Return how long is left as the end of a sentence, such as ", about 3 min left".

        It is empty where nothing is left, and where no part was done since the first call.
        """
        if self._began is None:
            self.begin(done)
        assert self._began is not None  # noqa: S101 - just begun
        (before, began_s), now = self._began, self._clock()
        if done <= before or done >= total:
            return ""
        left_s = (now - began_s) / (done - before) * (total - done)
        if left_s < 60:
            return ", less than 1 min left"
        minutes = round(left_s / 60)
        return f", about {minutes} min left" if minutes < 120 else f", about {minutes / 60:.1f} h left"
