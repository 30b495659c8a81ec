"""Entry point of a worker process, and what ends it; `vitac worker` calls `run`."""

import os
import signal
import threading
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from uuid import UUID

import structlog
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family
from vitac.errors import VitacError
from vitac.evaluator.agent.isolation.gpu import find_gpu
from vitac.evaluator.agent.isolation.memory_files import FILES_VARIABLE, FileIsolation
from vitac.evaluator.agent.verdicts import SandboxFailed
from vitac.evaluator.shards.process import ShardProcesses
from vitac.server.database.availability import DatabaseUnreachable
from vitac.server.database.states import WorkerOrder, WorkerState
from vitac.server.operations.housekeeping import Housekeeping
from vitac.server.queue.workers import declared_versions, explain_left_work, explain_other_evaluator
from vitac.server.services import Services, open_services
from vitac.server.settings import Settings
from vitac.server.storage.scratch import is_disk_full

from .capabilities import IsolationReport, probe_isolation
from .heartbeat import START_PATIENCE_S, Heartbeat
from .shard_run import StartShard
from .staging import SubmissionStage
from .worker import QueueWorker

logger = structlog.get_logger(__name__)

ProbeIsolation = Callable[[], IsolationReport]

DISK_AGAIN_S = 10.0
"""Pause of a worker that has no disk space to begin with."""

PROBE_AGAIN_S = 60.0
"""Pause of a worker that refuses: what kept it from isolating policies may have been repaired."""

LOOK_S = 0.5
"""Time between two looks for a reason to take no more shards."""


ALIVE_FILE = "worker.alive"
"""In the state directory."""
TOUCHED_EVERY_S = 5.0

ONCE_WAITS_S = 10.0
"""How long a worker that takes one piece of work waits for it [s]."""


class WorkerRefused(VitacError):
    """A worker with a limited stay may take no shards on this machine; waiting would only cost the time lent to it."""


@dataclass(frozen=True, kw_only=True)
class Stay:
    """What ends a worker by itself, after the work that it has begun.

    Attributes:
        runs: shards and playbacks that it takes; None: any number.
        idle_s: time without work after which it ends [s]; None: it waits.
        lifetime_s: time from `began` after which it takes no more [s]; None: without limit.
        began: on the monotonic clock [s].
    """

    runs: int | None = None
    idle_s: float | None = None
    lifetime_s: float | None = None
    began: float = field(default_factory=time.monotonic, compare=False)

    @property
    def is_limited(self) -> bool:
        """Whether anything but a request to stop ends it."""
        return self != UNLIMITED

    def is_over(self, *, taken: int, idle_s: float) -> bool:
        """Return whether a worker takes no more work.

        Args:
            taken: shards and playbacks that it has taken.
            idle_s: time since it had any [s].
        """
        pairs = ((taken, self.runs), (idle_s, self.idle_s), (time.monotonic() - self.began, self.lifetime_s))
        return any(limit is not None and value >= limit for value, limit in pairs)


UNLIMITED = Stay()


def run(settings: Settings, stay: Stay = UNLIMITED, *, probe: ProbeIsolation = probe_isolation) -> None:
    """Evaluate what is in the queue until SIGTERM or SIGINT, when shards at work are given back, or until `stay` ends.

    Raises:
        WorkerRefused: the stay is limited, and this machine may take no shards.
        DatabaseUnreachable: at the start, or for too long afterwards.
        VitacError: the file store cannot be used.
    """
    os.environ.setdefault(FILES_VARIABLE, FileIsolation.MEMORY)
    opening = open_services(settings, may_run_database=False, awaits_database=not stay.is_limited)
    with opening as services, ShardProcesses() as processes:
        processes.prepare()
        try:
            work(services, processes.running_shard, stay, probe=probe)
        except DBAPIError as error:
            raise DatabaseUnreachable.from_driver(error) from error


def work(
    services: Services,
    start: StartShard,
    stay: Stay = UNLIMITED,
    *,
    probe: ProbeIsolation = probe_isolation,
    families: Collection[Family] | None = None,
    enrol: Callable[[UUID], str | None] = lambda _: None,
) -> None:
    """Run one worker on open services; must be called in the main thread.

    Args:
        services: open.
        start: starts what plays a shard.
        stay: when it ends by itself.
        probe: finds out whether policies are isolated here.
        families: that it takes shards of; by default those that this machine can run.
        enrol: called with the worker's id before it takes its first shard; it raises where the worker may not, and
            returns the name of the station whose agent it is.

    Raises:
        WorkerRefused: the stay is limited, and this machine may take no shards.
    """
    stopping = threading.Event()
    with _stopped_by_signals(stopping), sign_of_life(services.settings.state_dir):
        while not stopping.is_set():
            report = probe()
            refusal = _explain_refused(services, report)
            if refusal is not None and stay.is_limited:
                raise WorkerRefused(refusal)
            if refusal is not None:
                _refuse(services, report, refusal, stopping)
                continue
            try:
                _take_shards(services, report, start, stopping, stay, families, enrol)
            except OSError as error:
                if not is_disk_full(error):
                    raise
                logger.error("disk_full", error=str(error))
                stopping.wait(DISK_AGAIN_S)


def _take_shards(
    services: Services,
    report: IsolationReport,
    start: StartShard,
    stopping: threading.Event,
    stay: Stay,
    families: Collection[Family] | None,
    enrol: Callable[[UUID], str | None],
) -> None:
    """Take and run shards until a request to stop, the stay's end, or until the service declares another evaluator."""
    leaving = threading.Event()

    def order() -> WorkerOrder:
        is_over = stay.is_over(taken=worker.taken, idle_s=worker.idle_s)
        return WorkerOrder.DRAIN if is_over else heartbeat.order

    with ExitStack() as stack:
        heartbeat = Heartbeat(
            services,
            state=WorkerState.READY,
            report=report,
            families=families,
            on_other_evaluator=leaving.set,
            on_upgrade=stopping.set,
        )
        heartbeat.start()
        stack.callback(heartbeat.stop)
        station = enrol(heartbeat.worker_id)
        stage = SubmissionStage(services.blobs, services.settings.scratch_dir, services.settings.limits)
        stack.callback(stage.close)
        housekeeping = Housekeeping(services, supersedes=False)
        housekeeping.start()
        stack.callback(housekeeping.stop)
        worker = QueueWorker(
            services, stage, heartbeat.worker_id, start, order=order, families=families, station=station
        )
        # A thread, not the signal's handler: that may interrupt whoever holds the locks which `stop` needs.
        threading.Thread(target=_stop_on_event, args=((stopping, leaving), worker), name="stop", daemon=True).start()
        logger.info("worker_started", worker=str(heartbeat.worker_id), slots=services.settings.worker_slots)
        worker.run()
        if order() is WorkerOrder.DRAIN:
            stopping.set()
        logger.info("worker_stopped", worker=str(heartbeat.worker_id))


def _explain_refused(services: Services, report: IsolationReport) -> str | None:
    """Return why this worker may take no shard at all; None if it may."""
    if services.settings.worker_gpu:
        try:
            find_gpu()
        except SandboxFailed as error:
            return str(error)
    if not report.is_sound:
        return f"This machine may not run policies: {' '.join(report.problems)} Run `vitac doctor` here."
    return services.database.retrying(_explain_other_evaluator, give_up_after_s=START_PATIENCE_S)


def _explain_other_evaluator(session: Session) -> str | None:
    """Return why a worker with this evaluator has nothing to do; None if the service has it or leaves it work."""
    problem = explain_other_evaluator(declared_versions(session))
    return problem if problem and not explain_left_work(session) else None


def _refuse(services: Services, report: IsolationReport, message: str, stopping: threading.Event) -> None:
    """Say on the organizers' pages why nothing is taken here, until it is time to look again."""
    logger.error("worker_refuses", message=message)
    heartbeat = Heartbeat(services, state=WorkerState.REFUSING, report=report, message=message, on_upgrade=stopping.set)
    heartbeat.start()
    stopping.wait(PROBE_AGAIN_S)
    heartbeat.stop()


def _stop_on_event(events: tuple[threading.Event, ...], worker: QueueWorker) -> None:
    while not any(event.is_set() for event in events):
        events[0].wait(LOOK_S)
    worker.stop()


@contextmanager
def _stopped_by_signals(stopping: threading.Event) -> Iterator[None]:
    """Set the event on SIGTERM or SIGINT while the block runs; a second one of the kind ends the process at once."""

    def handle(number: int, _frame: object) -> None:
        signal.signal(number, before[signal.Signals(number)])
        stopping.set()

    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    for number in before:
        signal.signal(number, handle)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def sign_of_life(folder: Path) -> Iterator[None]:
    """Touch the file while the block runs, whatever the database does; it is removed at the end."""
    file, over = folder / ALIVE_FILE, threading.Event()

    def touch() -> None:
        while not over.is_set():
            with suppress(OSError):  # a full disk
                file.touch()
            over.wait(TOUCHED_EVERY_S)

    thread = threading.Thread(target=touch, name="alive", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        file.unlink(missing_ok=True)
