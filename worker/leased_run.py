"""What all work on a lease has in common: a process of its own, the lease kept alive meanwhile, and how it ends."""

import tempfile
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from enum import StrEnum
from pathlib import Path
from typing import ClassVar, Generic, Protocol, TypeVar

import structlog
from sqlalchemy.orm import Session
from vitac.errors import VitacError
from vitac.evaluator.shards.order import AttemptSpent
from vitac.evaluator.tracks.sealed import write_secret
from vitac.server.competitions.sealing import find_secret
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.lifecycle import give_up
from vitac.server.queue import work
from vitac.server.queue.work import KINDS, Claim, LeaseLost
from vitac.server.services import Services
from vitac.server.storage.blobs import StoredFileLost
from vitac.server.storage.scratch import has_space, is_disk_full

DATABASE_PATIENCE_S = 600.0
"""So long a worker keeps what it has while the database is away."""
STORAGE_PATIENCE_S = 600.0
"""So long a worker waits for a storage that is unavailable before the attempt counts as failed."""
STORAGE_PAUSE_S = 1.0
FULL_DISK_PAUSE_S = 5.0
"""So long waits what a worker gave back because its disk was full."""


class RunEnd(StrEnum):
    """How the work on a lease ended."""

    FINISHED = "finished"  # the result is stored
    LOST = "lost"  # another worker has it, or it was ended from outside
    HANDED_BACK = "handed_back"  # this worker stops or has no disk space left
    BROKE = "broke"  # this machine could not do it; reported


class WorkStopped(VitacError):
    """The process was killed because its work had to end; another worker goes on with it, or nobody."""


class RunningProcess(Protocol):
    """What every process that works for a lease offers."""

    def kill(self) -> None:
        """End it at once."""


ProcessT = TypeVar("ProcessT", bound=RunningProcess)
ResultT = TypeVar("ResultT")


class LeasedRun(ABC, Generic[ProcessT]):
    """The work on one lease. `run` does it; `stop` may be called from any thread."""

    step: ClassVar[str]
    """What has to happen now and then, or the process counts as one that hangs: `episode ended`."""

    def __init__(self, services: Services, lease: Claim, **names: int | str) -> None:
        """Prepare; nothing is started.

        Args:
            services: open services.
            lease: on the work.
            names: what it is about, for log lines.
        """
        self.lease = lease
        self._services = services
        self._logger = structlog.get_logger(type(self).__module__).bind(
            work=lease.work_id, kind=str(lease.kind), attempt=lease.attempt, **names
        )
        self._limit_s = KINDS[lease.kind].limit_s
        self._began_at = time.monotonic()
        self._lock = threading.Lock()
        self._process: ProcessT | None = None
        self._stopping = threading.Event()
        self._lost = threading.Event()
        self._over = threading.Event()
        self._is_idle = threading.Event()
        self._moved_at = time.monotonic()

    def run(self) -> RunEnd:
        """Work until it is finished, lost, handed back or reported as broken."""
        renewing = threading.Thread(target=self._keep_lease, name=f"lease-{self.lease.work_id}", daemon=True)
        renewing.start()
        try:
            return self._work_or_end_early()
        except LeaseLost:
            return RunEnd.LOST
        finally:
            self._over.set()
            renewing.join()

    def stop(self) -> None:
        """End the process; `run` gives the work back."""
        self._stopping.set()
        self._kill()

    @abstractmethod
    def _work(self) -> None:
        """Do it and store the result; call `_watch` on the process and `_advance` after each step."""

    def _renew(self, session: Session) -> None:
        """Keep the lease for another while."""
        work.renew(session, self.lease, self._services.settings.lease_s)

    def _hand_back(self, session: Session, delay_s: float = 0.0) -> None:
        """Let another worker do it (after a while); this was no attempt."""
        work.hand_back(session, self.lease, delay_s=delay_s)

    def _report_broken(self, session: Session, message: str, *, is_free: bool = True) -> None:
        """Say that this machine could not do it, which counts as an attempt unless such ones are free."""
        settings = self._services.settings
        work.report_broken(session, settings, self.lease, message, give_up=give_up, is_free=is_free)

    def _report_too_slow(self, session: Session, limit_s: float) -> None:
        """Say that it took longer than an attempt may, which counts as one."""
        self._report_broken(session, f"It took longer than {limit_s:g} s.")

    def _watch(self, process: ProcessT) -> None:
        """Have the process killed when the work has to end, which may be so already."""
        with self._lock:
            self._process = process
        if self._stopping.is_set() or self._lost.is_set():
            process.kill()

    def _unwatch(self) -> None:
        """Leave the process alone from now on: it has done its work and may soon do other work."""
        with self._lock:
            self._process = None

    def _advance(self) -> None:
        self._moved_at = time.monotonic()

    def _database(self, change: Callable[[Session], ResultT]) -> ResultT:
        """Run a transaction, again and again while the database is away and the worker has not been asked to stop."""
        patience_s = 5.0 if self._stopping.is_set() else DATABASE_PATIENCE_S
        return self._services.database.retrying(change, give_up_after_s=patience_s)

    def _retry_storage(self, action: Callable[[], ResultT]) -> ResultT:
        """Do what needs the storage, again and again while that is unavailable and the work has not to end."""
        deadline = time.monotonic() + STORAGE_PATIENCE_S
        while True:
            try:
                return action()
            except ServiceError as error:
                may_pass = error.code is ProblemCode.STORAGE_UNAVAILABLE and not isinstance(error, StoredFileLost)
                ends = self._stopping.is_set() or self._lost.is_set() or time.monotonic() > deadline
                if ends or not may_pass:
                    raise
                self._logger.warning("storage_unavailable", error=error.detail)
            self._stopping.wait(STORAGE_PAUSE_S)
            self._advance()  # it waits, it does not hang

    def _fetch(self, stack: ExitStack, stage: Callable[[], AbstractContextManager[Path]]) -> Path:
        """Return where staged files are until the stack is closed."""
        return self._retry_storage(lambda: stack.enter_context(stage()))

    def _secret_file(self, stack: ExitStack, folder: Path, commitment: str | None) -> Path | None:
        """Return a file with the secret of the list to play, which only this user reads; None for the public list."""
        if commitment is None:
            return None
        secret = self._database(lambda session: find_secret(session, commitment))
        file = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sealed-", dir=folder))) / "secret"
        write_secret(file, secret)
        return file

    def _is_ended(self) -> bool:
        """Return whether the process was killed because the work had to end."""
        return self._stopping.is_set() or self._lost.is_set() or self._is_over_limit()

    def _work_or_end_early(self) -> RunEnd:
        try:
            self._work()
        except LeaseLost:
            raise
        except (VitacError, OSError) as error:
            return self._end_early(error)
        return RunEnd.FINISHED

    def _end_early(self, error: Exception) -> RunEnd:
        """Say what became of work whose process ended before its time, or whose result could not be stored."""
        if self._lost.is_set():
            return RunEnd.LOST
        message = " ".join(str(error).split())[:1000]
        if self._stopping.is_set():
            self._database(self._hand_back)
            return RunEnd.HANDED_BACK
        if self._lacks_space(error):
            self._logger.error("disk_full", error=message)
        if self._waits_for_space(error):
            self._database(lambda session: self._hand_back(session, FULL_DISK_PAUSE_S))
            return RunEnd.HANDED_BACK
        if self._limit_s is not None and self._is_over_limit():
            limit_s = self._limit_s
            self._logger.error("work_too_slow", limit_s=limit_s)
            self._database(lambda session: self._report_too_slow(session, limit_s))
            return RunEnd.BROKE
        if self._is_idle.is_set():
            message = f"No {self.step} within {self._services.settings.shard_idle_timeout_s:g} s."
        self._logger.error("work_broke", error=message)
        is_free = not isinstance(error, AttemptSpent)
        self._database(lambda session: self._report_broken(session, message, is_free=is_free))
        return RunEnd.BROKE

    def _lacks_space(self, error: Exception) -> bool:
        """Return whether the disk is full; a process may end with any error then, so we look."""
        return is_disk_full(error) or not self._has_space()

    def _waits_for_space(self, error: Exception) -> bool:
        """Return whether the work ended for lack of space in a way that counts as no attempt."""
        return self._lacks_space(error)

    def _has_space(self) -> bool:
        return all(has_space(folder) for folder in (self._services.settings.scratch_dir, Path(tempfile.gettempdir())))

    def _keep_lease(self) -> None:
        while not self._over.wait(self._services.settings.lease_renewal_s):
            try:
                self._database(self._renew)
                self._end_if_too_slow()
            except LeaseLost:
                self._lost.set()
                self._kill()
                return
            except Exception as error:  # noqa: BLE001 - whatever it is, the work itself continues and reports it
                self._logger.warning("lease_not_renewed", error=str(error))

    def _end_if_too_slow(self) -> None:
        """End a process that hangs or is over the limit of its kind: nothing else bounds the simulation."""
        if time.monotonic() - self._moved_at > self._services.settings.shard_idle_timeout_s:
            self._is_idle.set()
        if self._is_idle.is_set() or self._is_over_limit():
            self._kill()

    def _is_over_limit(self) -> bool:
        return self._limit_s is not None and time.monotonic() - self._began_at > self._limit_s

    def _kill(self) -> None:
        with self._lock:
            if self._process is not None:
                self._process.kill()
