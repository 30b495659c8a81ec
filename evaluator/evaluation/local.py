"""Evaluates a submission on this machine: all shards, of which those are stored that are complete."""

import hashlib
import os
import re
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from queue import SimpleQueue
from typing import Self

from pydantic import Field, ValidationError

from ..agent.isolation.packages import policy_versions
from ..agent.limits import Limits
from ..agent.session import Isolation
from ..episodes.records import EpisodeRecord, Manifest, PolicyFailure, RecordsDisagree, result_hash, sort_records
from ..figures.figures import FigureChoice, FiguresPart
from ..regression import Coefficients
from ..scoring.score import Score, breaking_failure, score
from ..shards.execution import ShardHere, ShardsHere
from ..shards.host_process import CAN_FORK, HostProcess
from ..shards.order import OnCalibration, ShardEnd, ShardOrder, ShardResult
from ..shards.process import ShardProcess, ShardProcesses
from ..strict_model import StrictModel
from ..submission_kinds import SubmissionKind
from ..tracks import Task, Track, load_track
from ..tracks.definition import ShardEpisodes, cut
from ..tracks.registry import find_version
from ..version import platform_class

# A shard that was neither finished nor used again for this time [s] is removed.
_UNUSED_S = 30 * 86400.0
# What a result depends on is in the name of what is played; these say only where it lies, which process plays it, and
# what would be learned again.
_NO_CONTENT = frozenset({"submission", "sensor", "coefficients"})
# Begins the name of a file that is being written.
_UNFINISHED = "unfinished-shard-"
# Names that are given here; whatever else lies in the folder is not ours to remove.
_OWN_NAME = re.compile(rf"[0-9a-f]{{64}}\.json|{_UNFINISHED}\w+")


class FinishedShard(StrictModel):
    """A shard with all its records."""

    records: tuple[EpisodeRecord, ...]
    result: ShardResult

    def answers(self, order: ShardOrder) -> bool:
        """Return whether it is the shard of an order that names its episodes."""
        played = {(record.task, record.episode) for record in self.records}
        return self.result.index == order.shard and played == {(order.task, it) for it in order.episodes or ()}


class StoredShards:
    """Finished shards in a folder, one file each, named by all that decides what is in it.

    Args:
        folder: made where it is not there.
        of: digest of what is played; for the standard estimator that of the sensor.
    """

    def __init__(self, folder: Path, *, of: str) -> None:
        self._folder, self._of = folder, of
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            _remove_unused(folder)

    def load(self, order: ShardOrder) -> FinishedShard | None:
        """Return a finished shard; None where it was not stored, or its file is damaged or of another shard."""
        path = self._path(order)
        try:
            finished = FinishedShard.model_validate_json(path.read_bytes())
            os.utime(path)
        except (OSError, ValidationError):
            return None
        return finished if finished.answers(order) else None

    def store(self, order: ShardOrder, records: Sequence[EpisodeRecord], result: ShardResult) -> None:
        """Store a shard whose episodes all have a record; without disk space nothing is stored."""
        content = FinishedShard(records=tuple(records), result=result).model_dump_json().encode()
        with suppress(OSError):
            handle, name = tempfile.mkstemp(dir=self._folder, prefix=_UNFINISHED)
            try:
                with os.fdopen(handle, "wb") as stream:
                    stream.write(content)
                Path(name).replace(self._path(order))
            except OSError:
                Path(name).unlink()
                raise

    def _path(self, order: ShardOrder) -> Path:
        parts = (find_version(order.track), platform_class(), self._of, order.model_dump_json(exclude=set(_NO_CONTENT)))
        digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()
        return self._folder / f"{digest}.json"


def _remove_unused(folder: Path) -> None:
    for path in folder.iterdir():
        if not _OWN_NAME.fullmatch(path.name):
            continue
        with suppress(OSError):  # another process has removed it, or it is a folder or not ours
            if time.time() - path.lstat().st_mtime > _UNUSED_S:
                path.unlink()


@dataclass(frozen=True, kw_only=True)
class LocalEvaluation:
    """A finished evaluation: its records in order, and either a score or the failure that ended it."""

    manifest: Manifest
    shards: tuple[ShardEpisodes, ...]
    records: tuple[EpisodeRecord, ...]
    isolation: Isolation | None
    """How strongly the policy was isolated; None if it never loaded."""
    coefficients: Coefficients | None = None
    """Coefficients of the standard estimator; None if it did not play."""
    figures: tuple[FiguresPart, ...] = ()
    """Parts of the figures of the sensor; none where they were not asked for."""
    packages: Mapping[str, str] = field(default_factory=dict)
    """Versions by name of all that the policy could import; nothing if none of the folder loaded."""

    @cached_property
    def failure(self) -> PolicyFailure | None:
        """Why there is no score, or None."""
        return breaking_failure(self.shards, self.records)

    @cached_property
    def score(self) -> Score | None:
        """The score; None if the policy failed."""
        if self.failure:
            return None
        return score(self.records, load_track(self.manifest.track).task(self.manifest.task).definition.measures)

    @cached_property
    def result_hash(self) -> str | None:
        """The hash that the service gives for the same evaluation; None if the policy failed."""
        return None if self.failure else result_hash(self.manifest, self.records)


def evaluate(
    *,
    submission_dir: Path,
    track: Track,
    task: Task,
    episodes: Iterable[int] | None = None,
    workers: int = 1,
    limits: Limits | None = None,
    assets_dir: Path | None = None,
    secret: Path | None = None,
    sensor: Path | None = None,
    kind: SubmissionKind = SubmissionKind.MODEL,
    remote: str | None = None,
    figures: FigureChoice = FigureChoice.NONE,
    coefficients: Coefficients | None = None,
    stored: StoredShards | None = None,
    on_episode: Callable[[EpisodeRecord], None] = lambda _: None,
    on_calibration: OnCalibration = lambda *_: None,
    host: HostProcess | None = None,
) -> LocalEvaluation:
    """Evaluate a submission in processes of its own, one shard at a time in each.

    Args:
        submission_dir: folder of the unpacked submission.
        track: the track of the task.
        task: what is played; of a sealed list as `sealed_track` has it.
        episodes: numbers to play; all by default.
        workers: processes at once.
        limits: of the policy; the default ones if None.
        assets_dir: folder with the challenge's own meshes; our own generated ones by default.
        secret: file with the secret of a sealed list.
        sensor: folder with a sensor of a team's own, in place of the challenge's.
        kind: of the submission, one that plays.
        remote: address of a policy server that plays in place of the folder's own code.
        figures: which of the sensor's figures the blind run measures.
        coefficients: of the standard estimator for the sensor; it is calibrated without them.
        stored: finished shards, which are not played again; new ones are added.
        on_episode: gets each record, in the order in which episodes end.
        on_calibration: gets how far the calibration of the sensor is, from threads.
        host: has begun to load the simulation; one is started where it is None.

    Raises:
        UnknownEpisodes: an episode is not in the list.
        ShardProcessFailed: the machine, the sandbox or the simulation broke.
    """
    shards = cut(task, episodes)
    orders = [
        ShardOrder(
            kind=kind,
            submission=submission_dir.resolve(),
            track=track.name,
            task=task.name,
            secret=secret.resolve() if secret else None,
            shard=shard.index,
            episodes=tuple(sorted(shard.numbers)),
            limits=limits or Limits(),
            assets_dir=assets_dir.resolve() if assets_dir else None,
            sensor=sensor.resolve() if sensor else None,
            remote=remote,
            figures=figures if task.measures_figures else FigureChoice.NONE,
            coefficients=coefficients,
        )
        for shard in shards
    ]
    records = []
    with ShardProcesses(host) if CAN_FORK else ShardsHere() as processes:
        workers = min(workers, len(orders)) if CAN_FORK else 1
        pool = _ShardPool(processes, orders, workers, stored, on_calibration)
        with closing(pool.run()) as finished:
            for record in finished:
                records.append(record)
                on_episode(record)
    isolation = next((result.isolation for result in pool.results if result.isolation), None)
    return LocalEvaluation(
        manifest=_common_manifest(pool.results),
        shards=shards,
        records=tuple(sort_records(task.name, records)),
        isolation=isolation,
        coefficients=next((result.coefficients for result in pool.results if result.coefficients), None),
        figures=tuple(result.figures for result in pool.results if result.figures),
        packages=policy_versions(submission_dir, track.packages) if isolation else {},
    )


class _ShardPool:
    """Threads that each wait for one shard process after another."""

    def __init__(
        self,
        processes: ShardProcesses | ShardsHere,
        orders: Sequence[ShardOrder],
        workers: int,
        stored: StoredShards | None,
        on_calibration: OnCalibration,
    ) -> None:
        self.results: list[ShardResult] = []
        self._on_calibration = on_calibration
        self._stored = stored
        self._coefficients: Coefficients | None = None
        """Coefficients from a finished shard, so that later shards need not calibrate again."""
        self._processes = processes
        self._orders = deque(orders)
        self._lock = threading.Lock()
        self._running: dict[int, ShardProcess | ShardHere] = {}
        self._given_up = False
        self._queue: SimpleQueue[EpisodeRecord | ShardResult | Exception | None] = SimpleQueue()
        self._threads = [threading.Thread(target=self._work, args=(slot,), daemon=True) for slot in range(workers)]

    def run(self) -> Generator[EpisodeRecord, None, None]:
        """Run everything; give the records as they come. Whatever ends it early ends the processes too."""
        for thread in self._threads:
            thread.start()
        try:
            yield from self._collect()
        finally:
            self._give_up()
            for thread in self._threads:
                thread.join()

    def _collect(self) -> Iterator[EpisodeRecord]:
        at_work = len(self._threads)
        while at_work:
            message = self._queue.get()
            if message is None:
                at_work -= 1
            elif isinstance(message, Exception):
                raise message
            elif isinstance(message, ShardResult):
                self.results.append(message)
            else:
                yield message

    def _work(self, slot: int) -> None:
        while order := self._next_order():
            try:
                self._run_order(order, slot)
            except Exception as error:  # noqa: BLE001 - the collecting thread raises it
                self._queue.put(error)
                break
        self._queue.put(None)

    def _run_order(self, order: ShardOrder, slot: int) -> None:
        known = self._stored.load(order) if self._stored else None
        result = self._play(order, slot) if known is None else known.result
        self._coefficients = result.coefficients or self._coefficients
        for record in () if known is None else known.records:
            self._queue.put(record)
        self._queue.put(result)

    def _play(self, order: ShardOrder, slot: int) -> ShardResult:
        records = []
        given = {"coefficients": order.coefficients or self._coefficients}
        with self._processes.running_shard(order.model_copy(update=given)) as process:
            self._register(slot, process)
            for record in process.records(self._on_calibration):
                records.append(record)
                self._queue.put(record)
        if process.result.end is ShardEnd.BROKEN:
            # Shards before this one continue; later ones cannot change how the evaluation ends.
            with self._lock:
                self._orders.clear()
        elif self._stored:
            self._stored.store(order, records, process.result)
        return process.result

    def _register(self, slot: int, process: ShardProcess | ShardHere) -> None:
        with self._lock:
            self._running[slot] = process
            if self._given_up:
                process.kill()

    def _next_order(self) -> ShardOrder | None:
        with self._lock:
            return self._orders.popleft() if self._orders else None

    def _give_up(self) -> None:
        with self._lock:
            self._given_up = True
            self._orders.clear()
            for process in self._running.values():
                process.kill()


def _common_manifest(results: Sequence[ShardResult]) -> Manifest:
    first = results[0].manifest
    if any(result.manifest != first for result in results):
        raise RecordsDisagree("The shards were made with different evaluators; evaluate again.")
    return first


class EvaluationReport(StrictModel):
    """Everything about an evaluation; either `score` and `result_hash` or `failure` is there.

    `packages` are the versions by name of all that the policy could import here, none of a policy server; no
    hash covers them.
    """

    name: str
    submission_digest: str
    manifest: Manifest
    isolation: Isolation | None
    score: Score | None
    result_hash: str | None
    failure: PolicyFailure | None
    packages: dict[str, str] = Field(default_factory=dict)
    episodes: tuple[EpisodeRecord, ...]

    @classmethod
    def from_evaluation(cls, evaluation: LocalEvaluation, *, name: str, digest: str) -> Self:
        """Return the report on an evaluation of the submission of that name and digest."""
        return cls(
            name=name,
            submission_digest=digest,
            manifest=evaluation.manifest,
            isolation=evaluation.isolation,
            score=evaluation.score,
            result_hash=evaluation.result_hash,
            failure=evaluation.failure,
            packages=dict(evaluation.packages),
            episodes=evaluation.records,
        )
