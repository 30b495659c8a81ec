"""Takes shards and playbacks from the queue and runs several at a time until a request to stop."""

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any
from uuid import UUID

import structlog
from procrastinate.exceptions import ProcrastinateException
from sqlalchemy.exc import DBAPIError
from vitac.envs.tasks.definition import Family
from vitac.evaluator.playback.process import making
from vitac.server.database.metrics import RetryReason
from vitac.server.database.states import WorkerOrder
from vitac.server.playbacks import work
from vitac.server.queue import leases
from vitac.server.queue.jobs import MAKE_PLAYBACK, RUN_SHARD, make_worker_app
from vitac.server.queue.leases import Lease
from vitac.server.services import Services
from vitac.server.traces import span

from .fitness import queues_here
from .leased_run import DATABASE_PATIENCE_S, RunEnd
from .playback_run import PlaybackRun, StartPlayback
from .shard_run import ShardRun, StartShard
from .slot import Slot
from .staging import SubmissionStage

logger = structlog.get_logger(__name__)

POLL_S = 1.0
"""A notification wakes the worker at once; polling finds jobs that were enqueued for later."""
RECONNECT_PAUSE_S = 0.5
LOOK_S = 0.5
"""Time between two looks for an order to take no more shards, or to take some again."""


class QueueWorker:
    """Runs shards and makes playbacks of the queue.

    `run` returns after `stop`, which may be called from any thread, or after the last shard when `order` says so.
    `taken` counts the shards and playbacks that it took.
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
    ) -> None:
        self._services = services
        self._stage = stage
        self._worker_id = worker_id
        self._start = start
        self._start_playback = start_playback
        self._families = families
        self._slots = services.settings.worker_slots
        self._free_slots = threading.Semaphore(self._slots)
        self._lock = threading.Lock()
        self._runs: set[ShardRun | PlaybackRun] = set()
        self._idle_since = time.monotonic()
        self.taken = 0
        self._stopping = False
        self._order = order
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopped: asyncio.Event | None = None

    @property
    def idle_s(self) -> float:
        """Time since it had a shard or playback, or since its start [s]; 0 while it has one."""
        with self._lock:
            return 0.0 if self._runs else time.monotonic() - self._idle_since

    async def run(self) -> None:
        """Work until `stop`; connects again whenever the database went away."""
        self._loop, self._stopped = asyncio.get_running_loop(), asyncio.Event()
        if self._stopping:
            return
        # As many shards as run may be played already while their results are stored.
        with ThreadPoolExecutor(2 * self._slots, thread_name_prefix="shard") as threads:
            while not self._stopped.is_set():
                try:
                    await self._work_while_connected(threads, self._stopped)
                    while self._order() is WorkerOrder.CORDON and not self._stopped.is_set():
                        await asyncio.sleep(LOOK_S)
                except (ProcrastinateException, OSError) as error:
                    logger.warning("queue_away", error=" ".join(repr(error.__cause__ or error).split())[:200])
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._stopped.wait(), RECONNECT_PAUSE_S)

    def stop(self) -> None:
        """Give all shards and playbacks back and end."""
        with self._lock:
            self._stopping = True
            running = list(self._runs)
        for run in running:
            run.stop()
        if self._loop is not None and self._stopped is not None:
            with contextlib.suppress(RuntimeError):  # the loop has ended by itself
                self._loop.call_soon_threadsafe(self._stopped.set)

    async def _wait_for_stop(self, stopped: asyncio.Event) -> None:
        """Wait until no further shard is to be taken."""
        while self._order() is WorkerOrder.WORK and not stopped.is_set():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(stopped.wait(), LOOK_S)
        if self._order() is WorkerOrder.DRAIN:
            stopped.set()

    async def _work_while_connected(self, threads: ThreadPoolExecutor, stopped: asyncio.Event) -> None:
        app = make_worker_app(self._services.database.address)

        @app.task(name=RUN_SHARD)
        async def run_shard(shard_id: int) -> None:
            await self._wait_until_next_is_due(threads, self._run_shard, shard_id)

        @app.task(name=MAKE_PLAYBACK)
        async def make_playback(playback_id: int) -> None:
            await self._wait_until_next_is_due(threads, self._make_playback, playback_id)

        async with app.open_async():
            working = asyncio.create_task(
                app.run_worker_async(
                    queues=queues_here(self._families),
                    concurrency=self._slots,
                    fetch_job_polling_interval=POLL_S,
                    delete_jobs="always",
                    install_signal_handlers=False,
                )
            )
            waiting = asyncio.create_task(self._wait_for_stop(stopped))
            await asyncio.wait({working, waiting}, return_when=asyncio.FIRST_COMPLETED)
            waiting.cancel()
            working.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await working

    async def _wait_until_next_is_due(
        self, threads: ThreadPoolExecutor, do: Callable[[int, Slot], None], number: int
    ) -> None:
        """Do a job in a thread, in a slot; return when it is time to fetch the next job, which waits for the slot.

        What is left of the work then continues without its job, which nobody needs: the row and its lease decide.
        """
        soon = asyncio.Event()
        slot = Slot(self._free_slots, partial(asyncio.get_running_loop().call_soon_threadsafe, soon.set))
        working = asyncio.wrap_future(threads.submit(slot.hold, partial(do, number, slot)))
        leaving = asyncio.create_task(soon.wait())
        awaited: set[asyncio.Future[Any]] = {working, leaving}
        try:
            await asyncio.wait(awaited, return_when=asyncio.FIRST_COMPLETED)
        except asyncio.CancelledError:
            working.cancel()  # unless it has begun
            raise
        finally:
            leaving.cancel()
        if working.done():
            await working

    def _run_shard(self, shard_id: int, slot: Slot) -> None:
        """Do one job, in a thread: the shard's row decides whether there is something to do.

        A job that waited for its slot when the worker was to take no more is left; the sweep gives its shard another.
        """
        if self._stopping or self._order() is not WorkerOrder.WORK:
            return
        lease = self._claim(shard_id)
        if lease is None:
            return
        evaluation = str(lease.evaluation_id)
        run = ShardRun(self._services, self._stage, lease, self._start, slot)
        names: dict[str, int | str] = {"shard": shard_id, "evaluation": evaluation}
        played = {**names, "task": lease.task, "attempt": lease.attempt, "waited_s": lease.waited_s}
        with span("shard", lease.traceparent, played) as found:
            end = self._ended(run, **names)
            found["end"] = str(end)
        if end is None:
            return
        self._count(end)
        log: Callable[..., object] = logger.info if end is RunEnd.FINISHED else logger.warning
        log(
            "shard_ended",
            shard=shard_id,
            evaluation=evaluation,
            task=lease.task,
            number=lease.number,
            attempt=lease.attempt,
            end=str(end),
        )

    def _make_playback(self, playback_id: int, _slot: Slot) -> None:
        """Do the job of a playback, in a thread; its row decides whether there is something to do."""
        if self._stopping or self._order() is not WorkerOrder.WORK:
            return
        lease_s = self._services.settings.lease_s
        lease = self._services.database.retrying(
            lambda session: work.claim(session, playback_id, lease_s), give_up_after_s=DATABASE_PATIENCE_S
        )
        if lease is not None:
            end = self._ended(PlaybackRun(self._services, lease, self._start_playback), playback=playback_id)
            logger.info("playback_ended", playback=playback_id, attempt=lease.attempt, end=str(end))

    def _ended(self, run: ShardRun | PlaybackRun, **names: int | str) -> RunEnd | None:
        """Run to the end; None where the database is away for too long, and the sweep gives the work to another."""
        with self._lock:
            self._runs.add(run)
            self.taken += 1
            stop_at_once = self._stopping
        if stop_at_once:
            run.stop()
        try:
            return run.run()
        except DBAPIError as error:
            logger.error("lease_left", error=" ".join(str(error).split())[:300], **names)
            return None
        except Exception:
            logger.exception("run_failed", **names)  # its job may have ended before, so that nobody else says it
            raise
        finally:
            with self._lock:
                self._runs.discard(run)
                self._idle_since = time.monotonic()

    def _claim(self, shard_id: int) -> Lease | None:
        lease_s = self._services.settings.lease_s
        instruments = self._services.instruments
        with instruments.claim_s.time():
            lease = self._services.database.retrying(
                lambda session: leases.claim(session, shard_id, self._worker_id, lease_s),
                give_up_after_s=DATABASE_PATIENCE_S,
            )
        if lease is not None:
            instruments.shard_wait_s.observe(lease.waited_s)
        return lease

    def _count(self, end: RunEnd) -> None:
        instruments = self._services.instruments
        if end is RunEnd.FINISHED:
            instruments.shards_finished.inc()
        elif end is RunEnd.LOST:
            instruments.leases_lost.inc()
        else:
            reason = RetryReason.BROKE if end is RunEnd.BROKE else RetryReason.HANDED_BACK
            instruments.shard_retries.labels(reason).inc()
