"""The worker's row: registered at its start, a heartbeat from a thread of its own, its end."""

import os
import platform
import threading
from collections.abc import Callable, Collection
from uuid import UUID, uuid4

import structlog
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family
from vitac.evaluator.version import evaluator_version, platform_class
from vitac.server.database.models import Worker
from vitac.server.database.schema import explain_other_schema
from vitac.server.database.states import WorkerOrder, WorkerState
from vitac.server.queue import workers
from vitac.server.queue.workers import declared_versions, explain_left_work, explain_other_evaluator
from vitac.server.services import Services

from .capabilities import IsolationReport, explain_unfit, fit_families

logger = structlog.get_logger(__name__)

START_PATIENCE_S = 60.0
"""A worker that cannot register for this time ends, and whoever started it starts it again."""


class Heartbeat:
    """The regular sign that this worker runs, from `start` to `stop`.

    Args:
        services: of this process.
        state: of the worker.
        report: how it isolates policies.
        message: for organizers; empty: of which tracks it takes no shards, and why.
        families: that it takes shards of; by default those that it can run.
        on_other_evaluator: called when the service has begun to declare another evaluator than this worker's.
        on_upgrade: called when the database has another schema than this release's: what the worker stores would be
            refused, and its shards given up after some attempts.
    """

    def __init__(
        self,
        services: Services,
        *,
        state: WorkerState,
        report: IsolationReport,
        message: str = "",
        families: Collection[Family] | None = None,
        on_other_evaluator: Callable[[], None] = lambda: None,
        on_upgrade: Callable[[], None],
    ) -> None:
        self.worker_id: UUID = uuid4()
        self.order = WorkerOrder.WORK
        """What an organizer wants of this worker, as of the last heartbeat."""
        self._services = services
        self._state = state
        self._report = report
        self._message = message
        self._families = families
        self._on_other_evaluator = on_other_evaluator
        self._on_upgrade = on_upgrade
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)

    def start(self) -> None:
        """Register the worker and begin; wait for a while for a database that restarts."""
        database = self._services.database
        database.retrying(self._register, give_up_after_s=START_PATIENCE_S)
        self._thread.start()

    def stop(self) -> None:
        """Report that the worker stops, and end."""
        self._stopping.set()
        self._thread.join()
        self._beat(WorkerState.STOPPED)

    def _run(self) -> None:
        while not self._stopping.wait(self._services.settings.worker_heartbeat_s):
            self._beat(self._state)
            other = self._other_schema()
            if other is not None:
                logger.error("other_schema", message=other)
                self._on_upgrade()
                return

    def _other_schema(self) -> str | None:
        """Return why this release cannot work with the schema; None where it can."""
        try:
            with self._services.database.engine.connect() as connection:
                return explain_other_schema(connection)
        except SQLAlchemyError:  # It does not answer; the next check will show.
            return None

    def _beat(self, state: WorkerState) -> None:
        try:
            with self._services.database.transaction() as session:
                declared = declared_versions(session)
                disk = workers.measure_disk(self._services.settings.scratch_dir)
                leaves = explain_other_evaluator(declared)
                left = explain_left_work(session) if leaves else None
                message = self._message or left or explain_unfit(declared, self._families)
                order = workers.heartbeat(session, self.worker_id, state, disk, message)
        except (SQLAlchemyError, OSError) as error:
            logger.warning("heartbeat_failed", error=" ".join(str(error).split())[:200])
        else:
            if leaves and not left:
                self._on_other_evaluator()
            if order is not None and state is not WorkerState.STOPPED:
                self._note(order)

    def _note(self, order: WorkerOrder) -> None:
        """Say from the next heartbeat on whether this worker takes shards."""
        self.order = order
        if self._state is not WorkerState.REFUSING:
            self._state = WorkerState.READY if order is WorkerOrder.WORK else WorkerState.CORDONED

    def _register(self, session: Session) -> None:
        workers.register(session, self._row(self._message or explain_unfit(declared_versions(session), self._families)))

    def _row(self, message: str) -> Worker:
        return Worker(
            id=self.worker_id,
            host=platform.node(),
            pid=os.getpid(),
            slots=self._services.settings.worker_slots,
            state=self._state,
            evaluator_version=evaluator_version(),
            has_gpu=self._services.settings.worker_gpu,
            families=[str(family) for family in fit_families(self._families)],
            platform_class=platform_class(),
            isolation=self._report.level,
            sandbox=self._report.sandbox.model_dump(mode="json") if self._report.sandbox else None,
            message=message,
        )
