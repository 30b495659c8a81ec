"""Claims work and does several pieces of it at a time until a request to stop."""

import threading
import time
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any, Self
from uuid import UUID

import psycopg
import structlog
from psycopg.conninfo import make_conninfo
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family
from vitac.evaluator.playback import making
from vitac.server.database.metrics import RetryReason
from vitac.server.database.states import WorkerOrder, WorkKind
from vitac.server.playbacks import work as playbacks
from vitac.server.queue import leases, work
from vitac.server.queue.leases import Lease
from vitac.server.queue.work import Claim, LeaseLost
from vitac.server.services import Services
from vitac.server.submissions import appeal_replays
from vitac.server.traces import span

from .capabilities import list_abilities
from .leased_run import DATABASE_PATIENCE_S, LeasedRun, RunEnd
from .shard_run import ShardRun, StartShard, name_evaluation
from .short_runs import PlaybackRun, ReplayRun, SensorCheckRun, StartPlayback
from .staging import SubmissionStage

logger = structlog.get_logger(__name__)

POLL_S = 1.0
"""A notification wakes the worker at once; polling finds work that had to wait."""
LOOK_S = 0.5
"""Time between two looks for an order to take no more work, or to take some again, and at the shares of kinds."""
_KEEPALIVES: dict[str, Any] = {
    "keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 3, "connect_timeout": 15,
}  # fmt: skip

AnyRun = LeasedRun[Any]


class QueueWorker:
    """Does work of the queue.

    `run` returns after `stop`, which may be called from any thread, or after the last work when `order` says so.
    `taken` counts what it took.
    """

    def __init__(
        self,
        services: Services,
        stage: SubmissionStage,
        worker_id: UUID,
        start: StartShard,
        start_playback: StartPlayback = making,
        order: Callable[[], WorkerOrder] = lambda: WorkerOrder.WORK,
        families: Collection[Family] | None = None,
        station: str | None = None,
    ) -> None:
        self._services = services
        self._stage = stage
        self._worker_id = worker_id
        self._start = start
        self._start_playback = start_playback
        self._families = families
        self._station = station
        self._slots = services.settings.worker_slots
        self._free_slots = threading.Semaphore(self._slots)
        # As much as runs may be played already while its results are stored.
        self._free_threads = threading.Semaphore(2 * self._slots)
        self._lock = threading.Lock()
        self._runs: set[AnyRun] = set()
        self._idle_since = time.monotonic()
        self.taken = 0
        self._over_share: Collection[WorkKind] = ()
        self._looked_at = float("-inf")
        self._stopping = threading.Event()
        self._order = order

    @property
    def idle_s(self) -> float:
        """Time since it had any work, or since its start [s]; 0 while it has some."""
        with self._lock:
            return 0.0 if self._runs else time.monotonic() - self._idle_since

    def run(self) -> None:
        """Work until `stop`, or an order to drain; go on whenever the database was away."""
        with ThreadPoolExecutor(2 * self._slots, "work") as threads, Bell(self._services.database.address) as bell:
            while not self._stopping.is_set() and (order := self._order()) is not WorkerOrder.DRAIN:
                bell.clear()
                if order is not WorkerOrder.WORK or not self._take_next(threads):
                    bell.wait(POLL_S if order is WorkerOrder.WORK else LOOK_S)

    def stop(self) -> None:
        """Give all work back and end."""
        with self._lock:
            self._stopping.set()
            running = list(self._runs)
        for run in running:
            run.stop()

    def _take_next(self, threads: ThreadPoolExecutor) -> bool:
        """Begin the next work in a thread; whether it is time to look again at once."""
        place = self._find_place()
        if place is None:
            return True
        claim = None
        try:
            # Either may have changed while there was no place.
            if self._order() is WorkerOrder.WORK and not self._stopping.is_set():
                claim = self._claim()
        except DBAPIError as error:
            logger.warning("queue_away", error=" ".join(str(error).split())[:200])
        if claim is None:
            place.give_back()
            return False
        with self._lock:
            self.taken += 1
        threads.submit(self._do, claim, place)
        return True

    def _find_place(self) -> "Place | None":
        """Wait for a moment for a free slot and thread."""
        if not self._free_slots.acquire(timeout=LOOK_S):
            return None
        if not self._free_threads.acquire(timeout=LOOK_S):
            self._free_slots.release()
            return None
        return Place(self._free_slots, self._free_threads)

    def _claim(self) -> Claim | None:
        database, settings = self._services.database, self._services.settings
        abilities = list_abilities(self._families, has_gpu=settings.worker_gpu, station=self._station)
        instruments = self._services.instruments
        if time.monotonic() - self._looked_at > LOOK_S:
            with database.transaction() as session:
                self._over_share = work.list_over_share(session, settings)
            self._looked_at = time.monotonic()
        began = time.perf_counter()
        claim = work.claim(database, settings, self._worker_id, abilities, self._over_share)
        if claim is not None:
            instruments.claim_s.observe(time.perf_counter() - began)
            if claim.kind in {WorkKind.SHARD, WorkKind.TRIAL}:
                instruments.shard_wait_s.observe(claim.waited_s)
        return claim

    def _do(self, claim: Claim, place: "Place") -> None:
        """Do claimed work, in a thread."""
        names: dict[str, int | str] = {"work": claim.work_id, "kind": str(claim.kind)}
        try:
            self._end(self._begin(claim, place), claim, names)
        except LeaseLost as error:
            logger.warning("work_ended", **names, end=str(RunEnd.LOST), error=str(error))
        except DBAPIError as error:  # it is away for too long: the sweep gives the work to another
            logger.error("lease_left", error=" ".join(str(error).split())[:300], **names)
        except Exception:
            logger.exception("run_failed", **names)
        finally:
            place.give_back()
            with self._lock:
                self._idle_since = time.monotonic()

    def _begin(self, claim: Claim, place: "Place") -> AnyRun:
        """Return the run of claimed work."""

        def begin(read: Callable[[Session, Claim], Any]) -> Any:
            return self._services.database.retrying(
                lambda session: read(session, claim), give_up_after_s=DATABASE_PATIENCE_S
            )

        if claim.kind is WorkKind.PLAYBACK:
            return PlaybackRun(self._services, begin(playbacks.begin), self._start_playback)
        if claim.kind is WorkKind.SENSOR_CHECK:
            return SensorCheckRun(self._services, self._stage, begin(leases.begin_check))
        if claim.kind is WorkKind.REPLAY:
            return ReplayRun(self._services, self._stage, begin(appeal_replays.begin), self._start)
        return ShardRun(self._services, self._stage, begin(leases.begin), self._start, place.leave_slot)

    def _end(self, run: AnyRun, claim: Claim, names: dict[str, int | str]) -> None:
        """Run to the end, and say and count how it ended."""
        if isinstance(claim_of := run.lease, Lease):
            names |= {**name_evaluation(claim_of), "task": claim_of.task, "number": claim_of.number}
        trace = claim_of.traceparent if isinstance(claim_of, Lease) else None
        with self._lock:
            self._runs.add(run)
            stops_at_once = self._stopping.is_set()
        if stops_at_once:
            run.stop()
        try:
            with span(str(claim.kind), trace, {**names, "attempt": claim.attempt, "waited_s": claim.waited_s}) as later:
                end = run.run()
                later["end"] = str(end)
        finally:
            with self._lock:
                self._runs.discard(run)
        log: Callable[..., object] = logger.info if end is RunEnd.FINISHED else logger.warning
        log("work_ended", **names, attempt=claim.attempt, end=str(end))
        if isinstance(claim_of, Lease):
            self._count(end)

    def _count(self, end: RunEnd) -> None:
        instruments = self._services.instruments
        if end is RunEnd.FINISHED:
            instruments.shards_finished.inc()
        elif end is RunEnd.LOST:
            instruments.leases_lost.inc()
        else:
            reason = RetryReason.BROKE if end is RunEnd.BROKE else RetryReason.HANDED_BACK
            instruments.shard_retries.labels(reason).inc()


class Place:
    """A slot for a simulation, and a thread. Work may leave the slot before it is over, with results to be stored."""

    def __init__(self, slots: threading.Semaphore, threads: threading.Semaphore) -> None:
        self._slots = slots
        self._threads = threads
        self._has_slot = True

    def leave_slot(self) -> None:
        """Let another simulation have the slot."""
        if self._has_slot:
            self._has_slot = False
            self._slots.release()

    def give_back(self) -> None:
        """Give back slot and thread."""
        self.leave_slot()
        self._threads.release()


class Bell:
    """Rings when the database says that something waits; it listens while its block runs.

    Args:
        address: of the database.
    """

    def __init__(self, address: str) -> None:
        self._address = make_conninfo(address, **_KEEPALIVES)
        self._rings = threading.Event()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="bell", daemon=True)
        self.clear = self._rings.clear
        self.wait = self._rings.wait

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._over.set()
        self._thread.join()

    def _listen(self) -> None:
        while not self._over.is_set():
            try:
                with psycopg.connect(self._address, autocommit=True) as connection:
                    connection.execute(f"LISTEN {work.CHANNEL}")
                    self._rings.set()  # earlier work rings no more
                    while not self._over.is_set():
                        for _ in connection.notifies(timeout=LOOK_S, stop_after=1):
                            self._rings.set()
            except psycopg.Error as error:
                logger.warning("queue_not_heard", error=" ".join(str(error).split())[:200])
                self._over.wait(LOOK_S)
