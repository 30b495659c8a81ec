"""Runs a twin in a process of its own, which shares nothing but its lines with what plays on it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from .bench import Bench
from .faults import Fault, FaultScript
from .grasp import CUBOID_PEG, Mounted
from .hidden import HiddenSettings
from .laboratory import playing_station


@dataclass(frozen=True)
class RunningTwin:
    """A twin in a process.

    Attributes:
        description: what a station's file says of it.
    """

    description: dict[str, Any]
    _line: Connection

    def begin(self, fault: Fault, for_s: float) -> None:
        """Break something for a while, by the twin's clock."""
        self._line.send((fault, for_s))
        self._line.recv()

    def is_whole(self) -> bool:
        """Say whether nothing is broken."""
        return self._ask()[0]

    def time_s(self) -> float:
        """Return the twin's time."""
        return self._ask()[1]

    def begun(self) -> tuple[Fault, ...]:
        """Return what has been broken so far."""
        return self._ask()[2]

    def _ask(self) -> tuple[bool, float, tuple[Fault, ...]]:
        self._line.send(None)
        is_whole, now_s, begun = self._line.recv()
        return is_whole, now_s, begun


@contextmanager
def twin_process(
    hidden: HiddenSettings,
    *,
    mounted: Mounted = CUBOID_PEG,
    script: FaultScript | None = None,
    period_s: float = 0.1,
) -> Iterator[RunningTwin]:
    """Start a twin that runs as fast as it can."""
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    arguments = (theirs, hidden, mounted, script or FaultScript(), period_s)
    process = context.Process(target=_run, args=arguments, daemon=True)
    process.start()
    theirs.close()
    try:
        yield RunningTwin(ours.recv(), ours)
    finally:
        ours.close()
        process.join()


def _run(caller: Connection, hidden: HiddenSettings, mounted: Mounted, script: FaultScript, period_s: float) -> None:
    """Run until the caller closes its end of the pipe or dies."""
    import cv2

    cv2.setNumThreads(1)
    bench = Bench(hidden=hidden, mounted=mounted, script=script, period_s=period_s, speed=None)
    with playing_station(bench) as station:
        caller.send(station.description)
        while True:
            try:
                asked = caller.recv()
            except EOFError:
                return
            if asked is not None:
                bench.begin(*asked)
            caller.send((bench.is_whole, bench.now_s, tuple(bench.begun)))
