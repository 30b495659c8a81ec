"""One claimed shard: run in a process of its own, each episode stored at once."""

import errno
import hashlib
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Protocol

from sqlalchemy.orm import Session
from vitac.errors import VitacError
from vitac.evaluator.agent.limits import Limits
from vitac.evaluator.episodes.records import EpisodeRecord, Manifest
from vitac.evaluator.figures.figures import FigureChoice, FiguresPart
from vitac.evaluator.regression import Coefficients
from vitac.evaluator.scoring.score import is_broken
from vitac.evaluator.shards.order import ShardEnd, ShardOrder, ShardResult
from vitac.evaluator.submission.manifest import load_manifest
from vitac.server.competitions.competition import find_stage
from vitac.server.competitions.definition import StageRules
from vitac.server.database.models import Submission
from vitac.server.database.states import FileRole, WorkKind
from vitac.server.errors import ServiceError
from vitac.server.evaluations.episode_store import StoredEpisodes, store_episodes, stored_episodes
from vitac.server.evaluations.lifecycle import finish_shard
from vitac.server.evaluations.provenance import known_manifest
from vitac.server.playbacks.stills import ask_for_new_stills
from vitac.server.queue.leases import Lease
from vitac.server.services import Services
from vitac.server.storage import stored_files
from vitac.server.storage.blobs import StoredFileLost
from vitac.server.storage.scratch import scratch_folder
from vitac.server.submissions.files import add_files
from vitac.server.submissions.intake import UPLOAD_FOLDER, UploadedFile
from vitac.server.submissions.kinds import require_allowed
from vitac.server.submissions.sensors import (
    coefficients_digest,
    coefficients_file,
    has_part,
    is_measured_by,
    is_played_by_estimator,
    known_part,
    part_file,
)

from .leased_run import LeasedRun, RunningProcess
from .staging import SubmissionStage


class VideoChanged(VitacError):
    """The file of a trial's video was changed after it was recorded; the trial is played again."""


TOGETHER_S = 0.5
"""Records that come within this time are stored in one transaction, which takes as long as that of a single one: about
as much CPU time of worker and database as two episodes take around their physics."""


class RecordStore:
    """Takes records while the shard runs on; every one is stored soon, and all are when `close` returns.

    Args:
        store: stores records; called from the thread.
        give_up: called, from the thread as well, when that has failed.
    """

    def __init__(self, store: Callable[[Sequence[EpisodeRecord]], None], give_up: Callable[[], None]) -> None:
        self._store = store
        self._give_up = give_up
        self._waiting: list[EpisodeRecord] = []
        self._lock = threading.Lock()
        self._has_come = threading.Event()
        self._closing = threading.Event()
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="records", daemon=True)
        self._thread.start()

    def add(self, record: EpisodeRecord) -> None:
        """Take a record."""
        with self._lock:
            self._waiting.append(record)
        self._has_come.set()

    def close(self) -> None:
        """Wait until all records are stored.

        Raises:
            Exception: what `store` has raised.
        """
        self._closing.set()
        self._has_come.set()
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _run(self) -> None:
        is_last = False
        while not is_last:
            self._has_come.wait()
            self._closing.wait(TOGETHER_S)
            self._has_come.clear()
            is_last = self._closing.is_set()
            try:
                self._store_waiting()
            except Exception as error:  # noqa: BLE001 - `close` raises it, in the thread that runs the shard
                self._error = error
                self._give_up()
                return

    def _store_waiting(self) -> None:
        with self._lock:
            records, self._waiting = self._waiting, []
        if records:
            self._store(records)


class RunningShard(RunningProcess, Protocol):
    """What a shard's process offers (`evaluator.shards.process.ShardProcess`)."""

    @property
    def packages(self) -> dict[str, str] | None:
        """Versions of the packages that the policy sees, by name; None where none runs, or before the first record."""

    @property
    def video(self) -> Path | None:
        """The video of the last record's trial; None where it has none."""

    @property
    def awaits_person(self) -> bool:
        """Whether it stands still until somebody at a station has decided."""

    def records(self) -> Iterator[EpisodeRecord]:
        """Yield each record as soon as its episode is over."""

    @property
    def result(self) -> ShardResult:
        """What the shard ended with."""


StartShard = Callable[[ShardOrder], AbstractContextManager[RunningShard]]


def name_evaluation(lease: Lease) -> dict[str, str]:
    """Return what log lines say of a shard's evaluation: nothing at a station, whose operators are not to know it."""
    return {} if lease.kind is WorkKind.TRIAL else {"evaluation": str(lease.evaluation_id)}


class ShardRun(LeasedRun[RunningShard]):
    """The work on the lease of a shard."""

    step = "episode ended"

    def __init__(
        self,
        services: Services,
        stage: SubmissionStage,
        lease: Lease,
        start: StartShard,
        leave_slot: Callable[[], object] = lambda: None,
    ) -> None:
        """Prepare; nothing is started.

        Args:
            services: open services.
            stage: submissions on this machine's disk.
            lease: on the shard.
            start: starts its process.
            leave_slot: called when all is played and the process has ended, or waits for another shard. What is left
                is to store the result.
        """
        super().__init__(services, lease, **name_evaluation(lease))
        self._stage = stage
        self._lease = lease
        self._start = start
        self._leave_slot = leave_slot
        self._began_with_space = False
        self._packages: dict[str, str] | None = None
        """What the policy sees, until it is stored."""

    def _renew(self, session: Session) -> None:
        super()._renew(session)
        if self._process is not None and self._process.awaits_person:
            self._advance()

    def _work(self) -> None:
        stored: StoredEpisodes = self._database(lambda session: stored_episodes(session, self._lease))
        result = self._result_without_running(stored) or self._play(stored)
        self._database(lambda session: finish_shard(session, self._lease, result))
        settings, evaluation = self._services.settings, self._lease.evaluation_id
        self._database(lambda session: ask_for_new_stills(session, settings, evaluation))

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
        store = RecordStore(self._store, give_up=self._kill)
        try:
            result = self._result_of_process(stored, store)
            has_learned = result.coefficients is not None or result.figures is not None
            # The next shards begin with what this one has learned of a sensor, and not at all where it has failed.
            if result.end is ShardEnd.COMPLETE and not has_learned:
                self._leave_slot()
        finally:
            store.close()
        if has_learned:
            self._keep(result)
        return result

    def _result_of_process(self, stored: StoredEpisodes, store: RecordStore) -> ShardResult:
        with ExitStack() as stack:
            path = self._fetch(
                stack, partial(self._stage.submission, self._lease.submission_kind, self._lease.archive_sha256)
            )
            made = self._lease.sensor_sha256
            sensor = None if made is None else self._fetch(stack, partial(self._stage.file, made))
            measures = is_measured_by(self._lease)
            known = self._known_part() if measures else None
            figures = FigureChoice.ALL if measures and known is None else FigureChoice.NONE
            secret = self._secret_file(stack, self._stage.folder, self._lease.commitment)
            order = self._order(path, stored, secret=secret, sensor=sensor, figures=figures)
            process = stack.enter_context(self._start(order))
            stack.callback(self._unwatch)
            self._watch(process)
            for number, record in enumerate(process.records()):
                if number == 0:
                    self._packages = process.packages
                self._advance()
                if process.video is not None:
                    self._keep_video(process.video, record)
                store.add(record)
            return process.result if known is None else process.result.model_copy(update={"figures": known})

    def _keep(self, result: ShardResult) -> None:
        """Store what is known of a sensor after a shard: what the estimator has learned, and a part of the figures."""
        with scratch_folder(self._services.settings.scratch_dir, UPLOAD_FOLDER) as folder:
            files = []
            if result.coefficients is not None:
                files.append(coefficients_file(result.coefficients, self._lease, folder))
            if result.figures is not None:
                files.append(part_file(result.figures, self._lease, folder))
                if result.figures.problem is not None:
                    self._logger.warning("figures_not_measured", error=result.figures.problem)
            for file in files:
                self._retry_storage(partial(self._database, partial(self._keep_file, file)))

    def _keep_video(self, path: Path, record: EpisodeRecord) -> None:
        """Store the video of a trial before its record names it.

        Raises:
            VideoChanged: the file is not the one that the record names.
        """
        video = record.video
        if video is not None:
            with path.open("rb") as content:
                digest = hashlib.file_digest(content, "sha256").hexdigest()
            if digest != video.sha256:
                raise VideoChanged(
                    f"The video of trial {record.episode} has another SHA-256 than its record says: {digest}, expected "
                    f"{video.sha256}. Something else wrote to {path.parent}; the trial is played again."
                )
            facts = {"task": record.task, "episode": record.episode, "code": video.code}
            name = f"trial-{record.task}-{record.episode}.mjpeg"
            file = UploadedFile(
                role=FileRole.VIDEO, path=path, sha256=video.sha256, n_bytes=video.n_bytes, name=name, facts=facts
            )
            self._retry_storage(partial(self._database, partial(self._keep_file, file)))

    def _keep_file(self, file: UploadedFile, session: Session) -> None:
        stored_files.store(session, self._services.blobs, file.path, file.sha256)
        add_files(session, self._lease.submission_id, [file])

    def _known_part(self) -> FiguresPart | None:
        """Return the shard's part of the figures where the team's same sensor was measured before; None elsewhere."""
        part: FiguresPart | None = self._database(lambda session: known_part(session, self._lease))
        return part

    def _order(
        self, path: Path, stored: StoredEpisodes, *, secret: Path | None, sensor: Path | None, figures: FigureChoice
    ) -> ShardOrder:
        rules = self._database(self._find_rules)
        return ShardOrder(
            kind=self._lease.submission_kind,
            submission=path,
            sensor=sensor,
            figures=figures,
            coefficients=self._coefficients(),
            episode_period_s=rules.episode_period_s,
            isolation=rules.isolation,
            remote=self._remote_address(path),
            code=self._lease.code,
            attempt=self._lease.attempt,
            track=self._lease.track,
            task=self._lease.task,
            evaluator_version=self._lease.evaluator_version,
            secret=secret,
            shard=self._lease.number,
            episodes=self._lease.episodes,
            limits=self._limits(rules),
            skip=tuple(sorted(stored.numbers)),
            earlier_failures=stored.failures,
        )

    def _limits(self, rules: StageRules) -> Limits:
        limits = self._services.settings.limits
        if rules.answer_s is None or not self._lease.submission_kind.form.is_remote:
            return limits
        return replace(limits, action_wall_s=rules.answer_s)

    def _remote_address(self, path: Path) -> str | None:
        """Return the address of the policy server that plays; None where the submission's own code does.

        Raises:
            ServiceError: the service may no longer ask it.
        """
        if not self._lease.submission_kind.form.is_remote:
            return None
        team: str = self._database(lambda session: session.get_one(Submission, self._lease.submission_id).team.name)
        return require_allowed(load_manifest(path).server(), self._services.settings, team)

    def _find_rules(self, session: Session) -> StageRules:
        return find_stage(session, session.get_one(Submission, self._lease.submission_id)).rules

    def _coefficients(self) -> Coefficients | None:
        """Return what the standard estimator has learned in an earlier shard; None where it is to learn it now."""
        sensor = self._lease.sensor_sha256
        if sensor is None or not is_played_by_estimator(self._lease):
            return None
        known = (self._lease.submission_id, self._lease.evaluation_id, sensor)
        digest: str | None = self._database(lambda session: coefficients_digest(session, *known))
        if digest is None:
            return None
        try:
            content = self._retry_storage(partial(self._services.blobs.read, digest))
        except StoredFileLost:
            self._logger.warning("coefficients_lost", sha256=digest)
            return None
        return Coefficients.model_validate_json(content)

    def _store(self, records: Sequence[EpisodeRecord]) -> None:
        packages = self._packages
        self._database(lambda session: store_episodes(session, self._lease, records, packages=packages))
        self._packages = None
        self._services.instruments.episodes.labels(self._lease.task).inc(len(records))

    def _waits_for_space(self, error: Exception) -> bool:
        """Return whether the shard lacked space that it cannot have used up itself.

        One that began with space may be what filled the disk. It would do so again, for ever if that did not count.
        """
        others_disk = isinstance(error, ServiceError)  # that of the stored files
        return super()._waits_for_space(error) and (others_disk or not self._began_with_space)
