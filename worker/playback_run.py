"""One claimed playback: made in a process of its own, its files stored, the lease kept alive meanwhile."""

import hashlib
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from types import MappingProxyType
from typing import Protocol, TypeVar

import structlog
from sqlalchemy.orm import Session
from vitac.envs.errors import VitacError
from vitac.evaluator.playback.order import CAMERAS_FILE, SCENE_FILE, STILL_FILE, PlaybackOrder
from vitac.evaluator.playback.process import PlaybackFailed
from vitac.server.playbacks import work
from vitac.server.playbacks.work import PlaybackLease
from vitac.server.queue.leases import LeaseLost
from vitac.server.services import Services
from vitac.server.storage import stored_files
from vitac.server.storage.disk_space import is_disk_full

from .shard_run import DATABASE_PATIENCE_S, FULL_DISK_PAUSE_S, RunEnd

logger = structlog.get_logger(__name__)
ResultT = TypeVar("ResultT")

FOLDER_PREFIX = "playback-"

_COLUMNS: Mapping[str, str] = MappingProxyType(
    {SCENE_FILE: "scene_sha256", CAMERAS_FILE: "cameras_sha256", STILL_FILE: "still_sha256"}
)


class RunningPlayback(Protocol):
    """What a playback's process offers (`evaluator.playback.process.MakingProcess`)."""

    def played(self) -> Iterator[int]:
        """Yield the number of played env steps; at the end the files are there."""

    def kill(self) -> None:
        """End it at once."""


StartPlayback = Callable[[PlaybackOrder], AbstractContextManager[RunningPlayback]]


class PlaybackRun:
    """The work on one lease. `run` does it; `stop` may be called from any thread."""

    def __init__(self, services: Services, lease: PlaybackLease, start: StartPlayback) -> None:
        self._services = services
        self._lease = lease
        self._start = start
        self._lock = threading.Lock()
        self._process: RunningPlayback | None = None
        self._stopping = threading.Event()
        self._lost = threading.Event()
        self._over = threading.Event()
        self._env_steps_played = 0
        self._moved_at = time.monotonic()

    def run(self) -> RunEnd:
        """Work until the playback is made, refused, lost, handed back or has failed on this machine."""
        renewing = threading.Thread(target=self._keep_lease, name=f"playback-{self._lease.playback_id}", daemon=True)
        renewing.start()
        try:
            return self._run()
        except LeaseLost:
            return RunEnd.LOST
        finally:
            self._over.set()
            renewing.join()

    def stop(self) -> None:
        """End the process; `run` gives the playback back."""
        self._stopping.set()
        self._kill()

    def _run(self) -> RunEnd:
        try:
            with tempfile.TemporaryDirectory(
                prefix=FOLDER_PREFIX, dir=self._services.settings.scratch_dir, ignore_cleanup_errors=True
            ) as folder:
                digests = self._make(Path(folder))
        except PlaybackFailed as error:
            problem = str(error)
            self._database(lambda session: work.end_failed(session, self._lease, problem))
            return RunEnd.FINISHED
        except LeaseLost:
            raise
        except (VitacError, OSError) as error:
            return self._end_early(error)
        self._database(lambda session: work.end_made(session, self._lease, digests))
        return RunEnd.FINISHED

    def _make(self, folder: Path) -> Mapping[str, str]:
        """Return the digests of the stored files by column."""
        order = PlaybackOrder(
            track=self._lease.track, record=self._lease.record, list_seed=self._lease.list_seed, folder=folder
        )
        with self._start(order) as process:
            with self._lock:
                self._process = process
            if self._stopping.is_set() or self._lost.is_set():
                process.kill()
            for count in process.played():
                self._env_steps_played, self._moved_at = count, time.monotonic()
        return {column: self._store(folder / name) for name, column in _COLUMNS.items() if (folder / name).exists()}

    def _store(self, path: Path) -> str:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        self._database(lambda session: stored_files.store(session, self._services.blobs, path, digest))
        return digest

    def _keep_lease(self) -> None:
        settings = self._services.settings
        while not self._over.wait(settings.lease_renewal_s):
            if time.monotonic() - self._moved_at > settings.shard_idle_timeout_s:
                self._kill()
            try:
                self._database(
                    lambda session: work.renew(
                        session, self._lease, settings.lease_s, env_steps_played=self._env_steps_played
                    )
                )
            except LeaseLost:
                self._lost.set()
                self._kill()
                return
            except Exception as error:  # noqa: BLE001 - whatever it is, the work itself goes on and will tell
                logger.warning("lease_not_renewed", playback=self._lease.playback_id, error=str(error))

    def _end_early(self, error: Exception) -> RunEnd:
        """Say what became of a playback whose process ended before its time, or whose files could not be stored."""
        if self._lost.is_set():
            return RunEnd.LOST
        message = " ".join(str(error).split())[:300]
        logger.warning("playback_broke", playback=self._lease.playback_id, attempt=self._lease.attempt, error=message)
        is_full = is_disk_full(error)
        if self._stopping.is_set() or is_full:
            delay_s = FULL_DISK_PAUSE_S if is_full else 0.0
            self._database(
                lambda session: work.hand_back(session, self._lease, counts_as_attempt=False, delay_s=delay_s)
            )
            return RunEnd.HANDED_BACK
        if self._lease.attempt >= self._services.settings.shard_attempts:
            problem = f"It could not be made in {self._lease.attempt} attempts: {message}"
            self._database(lambda session: work.end_failed(session, self._lease, problem))
        else:
            self._database(lambda session: work.hand_back(session, self._lease, counts_as_attempt=True))
        return RunEnd.BROKE

    def _database(self, change: Callable[[Session], ResultT]) -> ResultT:
        """Run a transaction, again and again while the database is away and the worker is not told to stop."""
        patience_s = 5.0 if self._stopping.is_set() else DATABASE_PATIENCE_S
        return self._services.database.retrying(change, give_up_after_s=patience_s)

    def _kill(self) -> None:
        with self._lock:
            if self._process is not None:
                self._process.kill()
