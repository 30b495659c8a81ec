"""Work that people wait for: playbacks, checks of sensors, and episodes that are played again for an appeal."""

import hashlib
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from sqlalchemy.orm import Session
from vitac.evaluator.playback import CAMERAS_FILE, FILM_FILE, SCENE_FILE, STILL_FILE, PlaybackFailed, PlaybackOrder
from vitac.evaluator.sensors.made import read_made_sensor
from vitac.evaluator.sensors.manifest import SensorRejected
from vitac.evaluator.shards.order import ShardOrder
from vitac.evaluator.submission.sensor import make_sensor
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.definition import cut
from vitac.server.database.states import FileRole, WorkState
from vitac.server.evaluations.lifecycle import end_check, fail_check
from vitac.server.evaluations.verdicts import ServiceVerdict
from vitac.server.playbacks import work as playbacks
from vitac.server.playbacks.work import PlaybackLease
from vitac.server.queue.leases import CheckLease
from vitac.server.queue.work import end
from vitac.server.services import Services
from vitac.server.storage import stored_files
from vitac.server.storage.scratch import scratch_folder
from vitac.server.submissions.appeal_replays import ReplayLease, end_played
from vitac.server.submissions.files import add_files
from vitac.server.submissions.intake import UPLOAD_FOLDER, UploadedFile

from .leased_run import LeasedRun, RunningProcess, WorkStopped
from .shard_run import RunningShard, StartShard
from .staging import SubmissionStage

PLAYBACK_FOLDER = "playback"
MADE_SENSOR = "made-sensor.json"

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
        super().__init__(services, lease)
        self._lease = lease
        self._start = start
        self._env_steps_played = 0

    def _work(self) -> None:
        try:
            with scratch_folder(self._services.settings.scratch_dir, PLAYBACK_FOLDER) as folder:
                digests = self._make(folder)
        except PlaybackFailed as error:
            problem = str(error)
            self._database(lambda session: end(session, self._lease, WorkState.FAILED, problem=problem))
        else:
            self._database(lambda session: playbacks.end_made(session, self._lease, digests))

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
        lease_s = self._services.settings.lease_s
        playbacks.renew(session, self._lease, lease_s, env_steps_played=self._env_steps_played)


class SensorCheckRun(LeasedRun[subprocess.Popen[bytes]]):
    """The work on the lease of a check of a sensor, which the sandbox makes of a team's files."""

    step = "sensor was made"

    def __init__(self, services: Services, stage: SubmissionStage, lease: CheckLease) -> None:
        super().__init__(services, lease, submission=str(lease.submission_id))
        self._stage = stage
        self._lease = lease

    def _work(self) -> None:
        with ExitStack() as stack:
            stage = partial(self._stage.submission, SubmissionKind.MODEL, self._lease.archive_sha256)
            submission = self._fetch(stack, stage)
            folder = stack.enter_context(scratch_folder(self._services.settings.scratch_dir, UPLOAD_FOLDER))
            try:
                file = self._make(submission, folder)
            except SensorRejected as error:
                if self._is_ended():  # it was killed, which looks like a fault of the sensor
                    raise WorkStopped("The check was ended.") from error
                message = str(error)
                self._database(
                    lambda session: fail_check(session, self._lease, ServiceVerdict.SENSOR_REJECTED, message)
                )
            else:
                self._retry_storage(partial(self._database, partial(self._keep, file)))

    def _make(self, submission: Path, folder: Path) -> UploadedFile:
        """Check and mesh the sensor; return what is scored."""
        made = make_sensor(submission, watch=self._watch)
        content, path = made.as_bytes(), folder / MADE_SENSOR
        path.write_bytes(content)
        return UploadedFile(
            role=FileRole.SENSOR,
            path=path,
            sha256=hashlib.sha256(content).hexdigest(),
            n_bytes=len(content),
            name=MADE_SENSOR,
            facts={"mesh_digest": made.mesh_digest, **made.facts.model_dump(mode="json")},
        )

    def _keep(self, file: UploadedFile, session: Session) -> None:
        stored_files.store(session, self._services.blobs, file.path, file.sha256)
        end_check(session, self._lease)
        add_files(session, self._lease.submission_id, [file])

    def _report_too_slow(self, session: Session, limit_s: float) -> None:
        message = f"Checking and meshing the sensor took longer than {limit_s:g} s, and was ended."
        fail_check(session, self._lease, ServiceVerdict.SENSOR_TOO_SLOW, message)


class ReplayRun(LeasedRun[RunningShard]):
    """The work on the lease of an episode that is played again for an appeal."""

    step = "episode ended"

    def __init__(self, services: Services, stage: SubmissionStage, lease: ReplayLease, start: StartShard) -> None:
        super().__init__(services, lease, task=lease.task, episode=lease.episode)
        self._stage = stage
        self._lease = lease
        self._start = start

    def _work(self) -> None:
        lease = self._lease
        with ExitStack() as stack:
            stage = partial(self._stage.submission, lease.policy_kind, lease.policy_sha256)
            submission = self._fetch(stack, stage)
            secret = self._secret_file(stack, self._stage.folder, lease.commitment)
            (piece,) = cut(load_track(lease.track).task(lease.task), [lease.episode])
            order = ShardOrder(
                kind=lease.policy_kind,
                submission=submission,
                track=lease.track,
                task=lease.task,
                evaluator_version=lease.evaluator_version,
                secret=secret,
                shard=piece.index,
                episodes=(lease.episode,),
                limits=self._services.settings.limits,
                isolation=lease.isolation,
            )
            process = stack.enter_context(self._start(order))
            stack.callback(self._unwatch)
            self._watch(process)
            (played,) = process.records()
        self._database(lambda session: end_played(session, lease, played))
