"""Shard processes that simulate nothing: for tests of the worker."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from service_factories import ISOLATION, make_manifest, make_record
from vitac.evaluator.episodes.records import EpisodeRecord, PolicyFailure
from vitac.evaluator.figures.figures import FiguresPart
from vitac.evaluator.regression import Coefficients
from vitac.evaluator.scoring.score import is_broken
from vitac.evaluator.shards.host_process import ShardProcessFailed
from vitac.evaluator.shards.order import ShardEnd, ShardOrder, ShardResult
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import cut


class FakeShard:
    """Gives a record for each episode that is asked for; `gate` is waited for before each one."""

    def __init__(
        self,
        order: ShardOrder,
        record_of: Callable[[int], EpisodeRecord],
        gate: Callable[[int], None],
        figures_of: Callable[[ShardOrder], FiguresPart | None],
        coefficients: Coefficients | None,
    ) -> None:
        self.order = order
        self.killed = threading.Event()
        self.packages = {"numpy": "2.5.0"}
        self.video: Path | None = None
        self.awaits_person = False
        self._record_of = record_of
        self._gate = gate
        self._figures_of = figures_of
        self._coefficients = coefficients
        self._result: ShardResult | None = None

    def records(self) -> Iterator[EpisodeRecord]:
        shard = cut(load_track(self.order.track).tasks[self.order.task])[self.order.shard]
        failures: list[PolicyFailure] = list(self.order.earlier_failures)
        for number in sorted(set(self.order.episodes or shard.numbers) - set(self.order.skip)):
            self._gate(number)
            if self.killed.is_set():
                raise ShardProcessFailed("the process was killed")
            record = self._record_of(number)
            yield record
            failures.extend([record.failure] if record.failure else [])
            if is_broken(failures):
                break
        end = ShardEnd.BROKEN if is_broken(failures) else ShardEnd.COMPLETE
        self._result = ShardResult(
            index=self.order.shard,
            end=end,
            manifest=make_manifest(self.order.task),
            isolation=ISOLATION,
            figures=self._figures_of(self.order),
            coefficients=self._coefficients,
        )

    @property
    def result(self) -> ShardResult:
        assert self._result is not None
        return self._result

    def kill(self) -> None:
        self.killed.set()


class FakeShards:
    """Starts fake shards and remembers them."""

    def __init__(
        self,
        record_of: Callable[[int], EpisodeRecord] = make_record,
        gate: Callable[[int], None] = lambda number: None,
        figures_of: Callable[[ShardOrder], FiguresPart | None] = lambda order: None,
        coefficients: Coefficients | None = None,
    ) -> None:
        self.started: list[FakeShard] = []
        self.record_of = record_of
        self.gate = gate
        self.figures_of = figures_of
        self.coefficients = coefficients

    @contextmanager
    def __call__(self, order: ShardOrder) -> Iterator[FakeShard]:
        shard = FakeShard(order, self.record_of, self.gate, self.figures_of, self.coefficients)
        self.started.append(shard)
        try:
            yield shard
        finally:
            shard.kill()


def eventually(holds: Callable[[], bool], limit_s: float = 120.0) -> None:
    """Waits until it holds, and looks less often as time goes on: looking takes time from what is waited for."""
    deadline, pause_s = time.monotonic() + limit_s, 0.005
    while not holds():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(pause_s)
        pause_s = min(1.2 * pause_s, 0.1)
