"""CPU time spent in one kind of work, summed up. Used by the environments for their `*_cpu_s` attributes."""

from time import thread_time


class Stopwatch:
    """Context manager that adds the CPU time of the calling thread [s] to `elapsed_s`."""

    def __init__(self) -> None:
        self.elapsed_s = 0.0
        self._started_s = 0.0

    def __enter__(self) -> None:
        self._started_s = thread_time()

    def __exit__(self, *exception: object) -> None:
        self.elapsed_s += thread_time() - self._started_s
