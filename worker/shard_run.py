"""One claimed shard: run in a process of its own, each episode stored at once, the lease kept alive meanwhile."""

import errno
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Protocol, TypeVar

import structlog
from sqlalchemy.orm import Session
from vitac.envs.errors import VitacError
from vitac.evaluator.episodes.records import EpisodeRecord, Manifest
from vitac.evaluator.figures.figures import FigureChoice
from vitac.evaluator.scoring.failures import is_broken
from vitac.evaluator.shards.order import ShardOrder
from vitac.evaluator.shards.result import ShardEnd, ShardResult
from vitac.server.competition.sealing import secret_of
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.episode_store import StoredEpisodes, store_episodes, stored_episodes
from vitac.server.evaluations.lifecycle import finish_shard, report_broken_machine
from vitac.server.evaluations.provenance import known_manifest
from vitac.server.queue import leases
from vitac.server.queue.leases import Lease, LeaseLost
from vitac.server.services import Services
from vitac.server.storage import stored_files
from vitac.server.storage.blobs import StoredFileLost
from vitac.server.storage.disk_space import has_space, is_disk_full
from vitac.server.submissions.figures import coefficients_file, has_part, is_measured_by, part_file
from vitac.server.submissions.files import add_files
from vitac.server.uploads.checked_upload import UploadedFile

from .record_store import RecordStore
from .staging import SubmissionStage

logger = structlog.get_logger(__name__)
ResultT = TypeVar("ResultT")

DATABASE_PATIENCE_S = 600.0
"""So long a worker keeps what it has while the database is away."""


FULL_DISK_PAUSE_S = 5.0
"""So long a shard waits that a worker gave back because its disk was full."""


STORAGE_PATIENCE_S = 600.0
"""So long a worker waits for a storage that is unavailable before the attempt counts as failed."""
STORAGE_PAUSE_S = 1.0


class RunningShard(Protocol):
    """What a shard's process offers (`evaluator.shards.process.ShardProcess`)."""

    def records(self) -> Iterator[EpisodeRecord]:
        """Yield each record as soon as its episode is over."""

    @property
    def result(self) -> ShardResult:
        """What the shard ended with."""

    def kill(self) -> None:
        """End it at once."""


StartShard = Callable[[ShardOrder], AbstractContextManager[RunningShard]]


class RunEnd(StrEnum):
    """How the work on a claimed shard ended."""

    FINISHED = "finished"  # all its episodes are stored and the shard is ended
    LOST = "lost"  # another worker has it, or its evaluation was ended
    HANDED_BACK = "handed_back"  # this worker stops or has no disk space left
    BROKE = "broke"  # the machine could not run it; reported


class ShardRun:
    """The work on one lease. `run` does it; `stop` may be called from any thread."""

    def __init__(self, services: Services, stage: SubmissionStage, lease: Lease, start: StartShard) -> None:
        self._services = services
        self._stage = stage
        self._lease = lease
        self._start = start
        self._lock = threading.Lock()
        self._process: RunningShard | None = None
        self._stopping = threading.Event()
        self._lost = threading.Event()
        self._over = threading.Event()
        self._is_idle = threading.Event()
        self._last_record_at = time.monotonic()
        self._began_with_space = False

    def run(self) -> RunEnd:
        """Work until the shard is finished, lost, handed back or reported as broken."""
        renewing = threading.Thread(target=self._keep_lease, name=f"lease-{self._lease.shard_id}", daemon=True)
        renewing.start()
        try:
            return self._run()
        except LeaseLost:
            return RunEnd.LOST
        except (VitacError, OSError) as error:
            return self._end_early(error)
        finally:
            self._over.set()
            renewing.join()

    def stop(self) -> None:
        """End the process; `run` gives the shard back."""
        self._stopping.set()
        self._kill()

    def _run(self) -> RunEnd:
        stored: StoredEpisodes = self._database(lambda session: stored_episodes(session, self._lease))
        result = self._result_without_running(stored) or self._play(stored)
        self._database(lambda session: finish_shard(session, self._lease, result))
        return RunEnd.FINISHED

    def _result_without_running(self, stored: StoredEpisodes) -> ShardResult | None:
        """Return the shard's end if nothing is left to play; None otherwise, or if nobody has played the task yet."""
        broken = is_broken(stored.failures)
        if not broken and not stored.numbers.issuperset(self._lease.episodes):
            return None
        if is_measured_by(self._lease) and not self._database(lambda session: has_part(session, self._lease)):
            return None
        manifest: Manifest | None = self._database(lambda session: known_manifest(session, self._lease))
        if manifest is None:
            return None
        end = ShardEnd.BROKEN if broken else ShardEnd.COMPLETE
        return ShardResult(index=self._lease.number, end=end, manifest=manifest, isolation=None)

    def _play(self, stored: StoredEpisodes) -> ShardResult:
        if not self._has_space():
            raise OSError(errno.ENOSPC, "Expected free space on the disk of the worker's files, got a full one")
        self._began_with_space = True
        with ExitStack() as stack:
            path = self._fetch(stack, partial(self._stage.submission, self._lease.kind, self._lease.archive_sha256))
            made = self._lease.sensor_sha256
            sensor = None if made is None else self._fetch(stack, partial(self._stage.file, made))
            order = self._order(path, stored, secret=self._secret_file(stack), sensor=sensor)
            process = stack.enter_context(self._start(order))
            with self._lock:
                self._process = process
            if self._stopping.is_set() or self._lost.is_set():
                process.kill()
            store = RecordStore(self._store, give_up=process.kill)
            try:
                for record in process.records():
                    self._last_record_at = time.monotonic()
                    store.add(record)
            finally:
                store.close()
            self._keep(process.result)
            return process.result

    def _fetch(self, stack: ExitStack, stage: Callable[[], AbstractContextManager[Path]]) -> Path:
        """Return where staged files are until the stack is closed; wait while the storage is unavailable."""
        deadline = time.monotonic() + STORAGE_PATIENCE_S
        while True:
            try:
                return stack.enter_context(stage())
            except ServiceError as error:
                may_pass = error.code is ProblemCode.STORAGE_UNAVAILABLE and not isinstance(error, StoredFileLost)
                ends = self._stopping.is_set() or self._lost.is_set() or time.monotonic() > deadline
                if ends or not may_pass:
                    raise
                logger.warning("storage_unavailable", shard=self._lease.shard_id, error=error.detail)
                self._stopping.wait(STORAGE_PAUSE_S)

    def _secret_file(self, stack: ExitStack) -> Path | None:
        """Return a file with the secret of the list to play, which only this user reads; None for the public list."""
        commitment = self._lease.commitment
        if commitment is None:
            return None
        secret = self._database(lambda session: secret_of(session, commitment))
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="sealed-", dir=self._stage.folder))
        file = Path(folder) / "secret"
        file.touch(mode=0o600)
        file.write_text(secret)
        return file

    def _keep(self, result: ShardResult) -> None:
        """Store what is known of a sensor after a shard: what the estimator has learned, and a part of the figures."""
        with tempfile.TemporaryDirectory(prefix="upload-", dir=self._services.settings.scratch_dir) as name:
            folder, files = Path(name), []
            if result.coefficients is not None:
                files.append(coefficients_file(result.coefficients, folder))
            if result.figures is not None:
                files.append(part_file(result.figures, self._lease, folder))
            for file in files:
                self._database(partial(self._keep_file, file))

    def _keep_file(self, file: UploadedFile, session: Session) -> None:
        stored_files.store(session, self._services.blobs, file.path, file.sha256)
        add_files(session, self._lease.submission_id, [file])

    def _order(self, path: Path, stored: StoredEpisodes, *, secret: Path | None, sensor: Path | None) -> ShardOrder:
        return ShardOrder(
            kind=self._lease.kind,
            submission=path,
            sensor=sensor,
            figures=FigureChoice.ALL if is_measured_by(self._lease) else FigureChoice.NONE,
            track=self._lease.track,
            task=self._lease.task,
            secret=secret,
            shard=self._lease.number,
            episodes=self._lease.episodes,
            limits=self._services.settings.limits,
            skip=tuple(sorted(stored.numbers)),
            earlier_failures=stored.failures,
        )

    def _store(self, records: Sequence[EpisodeRecord]) -> None:
        self._database(lambda session: store_episodes(session, self._lease, records))
        self._services.instruments.episodes.labels(self._lease.task).inc(len(records))

    def _keep_lease(self) -> None:
        settings = self._services.settings
        while not self._over.wait(settings.lease_renewal_s):
            try:
                self._database(lambda session: leases.renew(session, self._lease, settings.lease_s))
                self._end_if_idle()
            except LeaseLost:
                self._lost.set()
                self._kill()
                return
            except Exception as error:  # noqa: BLE001 - whatever it is, the work itself goes on and will tell
                logger.warning("lease_not_renewed", shard=self._lease.shard_id, error=str(error))

    def _end_if_idle(self) -> None:
        """End a process that hangs: its limits bound the policy, but nothing else bounds the simulation."""
        if time.monotonic() - self._last_record_at > self._services.settings.shard_idle_timeout_s:
            self._is_idle.set()
            self._kill()

    def _end_early(self, error: Exception) -> RunEnd:
        """Say what became of a shard whose process ended before its time."""
        if self._lost.is_set():
            return RunEnd.LOST
        try:
            if self._stopping.is_set():
                self._database(lambda session: leases.hand_back(session, self._lease, counts_as_attempt=False))
                return RunEnd.HANDED_BACK
            if self._lacks_space(error):
                logger.error("disk_full", shard=self._lease.shard_id, error=" ".join(str(error).split())[:300])
            if self._waits_for_space(error):
                self._database(
                    lambda session: leases.hand_back(
                        session, self._lease, counts_as_attempt=False, delay_s=FULL_DISK_PAUSE_S
                    )
                )
                return RunEnd.HANDED_BACK
            message = " ".join(str(error).split())[:1000]
            if self._is_idle.is_set():
                message = f"No episode ended within {self._services.settings.shard_idle_timeout_s:g} s."
            logger.error("shard_broke", shard=self._lease.shard_id, attempt=self._lease.attempt, error=message)
            settings = self._services.settings
            self._database(lambda session: report_broken_machine(session, settings, self._lease, message))
        except LeaseLost:
            return RunEnd.LOST
        return RunEnd.BROKE

    def _lacks_space(self, error: Exception) -> bool:
        """Return whether the disk is full; the process of a shard may end with any error then, so we look."""
        return is_disk_full(error) or not self._has_space()

    def _waits_for_space(self, error: Exception) -> bool:
        """Return whether the shard lacked space that it cannot have used up itself: that counts as no attempt.

        One that began with space may be what filled the disk. It would do so again, for ever if that did not count.
        """
        others_disk = isinstance(error, ServiceError)  # that of the stored files
        return self._lacks_space(error) and (others_disk or not self._began_with_space)

    def _has_space(self) -> bool:
        return all(has_space(folder) for folder in (self._services.settings.scratch_dir, Path(tempfile.gettempdir())))

    def _database(self, work: Callable[[Session], ResultT]) -> ResultT:
        """Run a transaction, again and again while the database is away and the worker is not told to stop."""
        patience_s = 5.0 if self._stopping.is_set() else DATABASE_PATIENCE_S
        return self._services.database.retrying(work, give_up_after_s=patience_s)

    def _kill(self) -> None:
        with self._lock:
            if self._process is not None:
                self._process.kill()
