"""One claimed playback: made in a process of its own, its files stored."""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from sqlalchemy.orm import Session
from vitac.evaluator.playback.making import CAMERAS_FILE, FILM_FILE, SCENE_FILE, STILL_FILE, PlaybackOrder
from vitac.evaluator.playback.process import PlaybackFailed
from vitac.evaluator.sensors.made import read_made_sensor
from vitac.server.evaluations.lifecycle import RETRY_DELAY_S
from vitac.server.playbacks import work
from vitac.server.playbacks.work import PlaybackLease
from vitac.server.services import Services
from vitac.server.storage import stored_files
from vitac.server.storage.scratch import scratch_folder

from .leased_run import LeasedRun, RunningProcess

PLAYBACK_FOLDER = "playback"

_COLUMNS: Mapping[str, str] = MappingProxyType(
    {
        SCENE_FILE: "scene_sha256",
        CAMERAS_FILE: "cameras_sha256",
        STILL_FILE: "still_sha256",
        FILM_FILE: "film_sha256",
    }
)


class RunningPlayback(RunningProcess, Protocol):
    """What a playback's process offers (`evaluator.playback.process.MakingProcess`)."""

    def played(self) -> Iterator[int]:
        """Yield the number of played env steps; at the end the files are there."""


StartPlayback = Callable[[PlaybackOrder], AbstractContextManager[RunningPlayback]]


class PlaybackRun(LeasedRun[RunningPlayback]):
    """The work on the lease of a playback."""

    step = "env step was played"

    def __init__(self, services: Services, lease: PlaybackLease, start: StartPlayback) -> None:
        super().__init__(services, playback=lease.playback_id, attempt=lease.attempt)
        self._lease = lease
        self._start = start
        self._env_steps_played = 0

    def _work(self) -> None:
        try:
            with scratch_folder(self._services.settings.scratch_dir, PLAYBACK_FOLDER) as folder:
                digests = self._make(folder)
        except PlaybackFailed as error:
            problem = str(error)
            self._database(lambda session: work.end_failed(session, self._lease, problem))
        else:
            self._database(lambda session: work.end_made(session, self._lease, digests))

    def _make(self, folder: Path) -> Mapping[str, str]:
        """Return the digests of the stored files by column."""
        made = self._lease.sensor_sha256
        stored = None if made is None else self._retry_storage(partial(self._services.blobs.read, made))
        order = PlaybackOrder(
            track=self._lease.track,
            record=self._lease.record,
            list_seed=self._lease.list_seed,
            sensor=None if stored is None else read_made_sensor(stored),
            folder=folder,
        )
        with self._start(order) as process:
            self._watch(process)
            for count in process.played():
                self._env_steps_played = count
                self._advance()
        return {column: self._store(folder / name) for name, column in _COLUMNS.items() if (folder / name).exists()}

    def _store(self, path: Path) -> str:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        self._retry_storage(partial(self._database, partial(self._store_file, path, digest)))
        return digest

    def _store_file(self, path: Path, digest: str, session: Session) -> None:
        stored_files.store(session, self._services.blobs, path, digest)

    def _renew(self, session: Session) -> None:
        work.renew(session, self._lease, self._services.settings.lease_s, env_steps_played=self._env_steps_played)

    def _hand_back(self, session: Session, delay_s: float = 0.0) -> None:
        work.hand_back(session, self._lease, counts_as_attempt=False, delay_s=delay_s)

    def _report_broken(self, session: Session, message: str) -> None:
        """Let it be tried again after a while, or end it with the last attempt."""
        if self._lease.attempt < self._services.settings.shard_attempts:
            delay_s = self._lease.attempt * RETRY_DELAY_S
            work.hand_back(session, self._lease, counts_as_attempt=True, delay_s=delay_s)
        else:
            problem = f"It could not be made in {self._lease.attempt} attempts: {message[:300]}"
            work.end_failed(session, self._lease, problem)
