"""Workers as the service knows them: registration, heartbeats, and whether any is alive."""

import json
import shutil
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path
from uuid import UUID

from sqlalchemy import ColumnElement, Select, and_, delete, exists, func, select, update
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family
from vitac.evaluator.agent.description import SandboxDescription
from vitac.evaluator.tracks import list_tracks
from vitac.evaluator.tracks.registry import current_versions, find_evaluator, find_version
from vitac.evaluator.version import evaluator_version

from ..audit import record
from ..database.clock import read_clock
from ..database.models import DeclaredEvaluator, Evaluation, Shard, Worker
from ..database.states import ACTIVE_EVALUATION_STATES, WorkerOrder, WorkerState, WorkState
from ..errors import ProblemCode, ServiceError, not_found
from ..principals import Principal
from ..settings import OutdatedRule, Settings
from ..views.operations import WorkerView

FORGOTTEN_AFTER = timedelta(days=7)


@dataclass(frozen=True, kw_only=True)
class WorkersAlive:
    """How many workers take shards now, how many shards they run at once, and the last heartbeat of any."""

    alive: int
    slots: int
    last_heartbeat_at: datetime | None


@dataclass(frozen=True, kw_only=True)
class AlikeWorkers:
    """Workers that can run the same: how many of them take shards and are not lost, and how many shards at once."""

    evaluator_version: str
    families: Collection[str]
    has_gpu: bool
    alive: int
    slots: int


@dataclass(frozen=True, kw_only=True)
class Fleet:
    """The workers known now, in groups, and the last heartbeat of any."""

    groups: Sequence[AlikeWorkers]
    last_heartbeat_at: datetime | None

    def alive(
        self, evaluator_version: str | None = None, family: Family | None = None, *, needs_gpu: bool = False
    ) -> WorkersAlive:
        """Return those alive of one evaluator version, of one family, None: of any; or with a GPU alone."""
        wanted = find_evaluator(evaluator_version) if evaluator_version else None
        matching = [
            group
            for group in self.groups
            if wanted in {None, group.evaluator_version}
            and (family is None or family in group.families)
            and (group.has_gpu or not needs_gpu)
        ]
        return WorkersAlive(
            alive=sum(group.alive for group in matching),
            slots=sum(group.slots for group in matching),
            last_heartbeat_at=self.last_heartbeat_at,
        )


@dataclass(frozen=True, kw_only=True)
class Disk:
    """Size of a disk and what is free on it."""

    total_bytes: int
    free_bytes: int


def measure_disk(folder: Path) -> Disk:
    """Return the disk that a folder is on."""
    usage = shutil.disk_usage(folder)
    return Disk(total_bytes=usage.total, free_bytes=usage.free)


def register(session: Session, worker: Worker) -> None:
    """Add a worker process and forget those without a heartbeat for a week."""
    session.execute(delete(Worker).where(Worker.heartbeat_at < read_clock(session) - FORGOTTEN_AFTER))
    session.add(worker)


def heartbeat(
    session: Session, worker_id: UUID, state: WorkerState, disk: Disk, message: str = ""
) -> WorkerOrder | None:
    """Record that a worker is there and what it says about itself and its disk; return what it is to do.

    None where nobody knows it any longer.
    """
    return session.scalar(
        update(Worker)
        .where(Worker.id == worker_id)
        .values(
            heartbeat_at=func.clock_timestamp(),
            state=state,
            message=message,
            disk_bytes=disk.total_bytes,
            disk_free_bytes=disk.free_bytes,
        )
        .returning(Worker.worker_order)
    )


def is_alive(settings: Settings) -> ColumnElement[bool]:
    """Return the condition that a worker takes shards and is not lost."""
    return _takes_shards(settings.worker_lost_after_s)


def _takes_shards(lost_after_s: float) -> ColumnElement[bool]:
    lost_before = func.clock_timestamp() - timedelta(seconds=lost_after_s)
    return and_(Worker.state == WorkerState.READY, Worker.heartbeat_at > lost_before)


@cache
def _alike(lost_after_s: float) -> Select[str, list[str], bool, int, int, datetime]:
    """Return the query of groups of workers, which is put together once: it is part of each page of submissions."""
    taking = _takes_shards(lost_after_s)
    return select(
        Worker.evaluator_version,
        Worker.families,
        Worker.has_gpu,
        func.count().filter(taking),
        func.coalesce(func.sum(Worker.slots).filter(taking), 0),
        func.max(Worker.heartbeat_at),
    ).group_by(Worker.evaluator_version, Worker.families, Worker.has_gpu)


def fleet(session: Session, settings: Settings) -> Fleet:
    """Return the workers that take shards and are not lost."""
    rows = session.execute(_alike(settings.worker_lost_after_s)).all()
    groups = [
        AlikeWorkers(evaluator_version=version, families=families, has_gpu=has_gpu, alive=alive, slots=slots)
        for version, families, has_gpu, alive, slots, _ in rows
    ]
    return Fleet(groups=groups, last_heartbeat_at=max((row[-1] for row in rows), default=None))


def workers_alive(session: Session, settings: Settings, evaluator_version: str | None = None) -> WorkersAlive:
    """Return the workers that take shards (of one evaluator version) and are not lost."""
    return fleet(session, settings).alive(evaluator_version)


def sandboxes(session: Session, settings: Settings) -> Sequence[SandboxDescription]:
    """Return what policies find on the workers that take shards, each once; without any, on the last one that did."""
    described = select(Worker.sandbox).where(Worker.sandbox.is_not(None)).order_by(Worker.heartbeat_at.desc())
    rows = session.scalars(described.where(is_alive(settings))).all() or session.scalars(described.limit(1)).all()
    sandboxes_seen = []
    for row in rows:
        description = SandboxDescription.model_validate_json(json.dumps(row))
        if description not in sandboxes_seen:
            sandboxes_seen.append(description)
    return sandboxes_seen


def list_workers(session: Session) -> Sequence[Worker]:
    """Return all known workers, the one with the newest heartbeat first."""
    return session.scalars(select(Worker).order_by(Worker.heartbeat_at.desc())).all()


def list_views(session: Session, settings: Settings) -> list[WorkerView]:
    """Return all known workers as organizers see them, the one with the newest heartbeat first."""
    shards, now = running_shards(session), read_clock(session)
    return [worker_view(one, settings, now=now, shards=shards.get(one.id, ())) for one in list_workers(session)]


def view_worker(session: Session, settings: Settings, worker_id: UUID) -> WorkerView:
    """Return one worker as organizers see it.

    Raises:
        ServiceError: there is none.
    """
    shards = running_shards(session).get(worker_id, ())
    return worker_view(find(session, worker_id), settings, now=read_clock(session), shards=shards)


def find(session: Session, worker_id: UUID) -> Worker:
    """Return the worker of that id.

    Raises:
        ServiceError: there is none.
    """
    worker = session.get(Worker, worker_id)
    if worker is None:
        raise not_found("worker", worker_id)
    return worker


def give_order(session: Session, by: Principal, worker_id: UUID, order: WorkerOrder) -> Worker:
    """Have a worker take shards, take none, or end after its last one; it obeys at its next heartbeat.

    Raises:
        ServiceError: not an organizer, there is no such worker, or it has ended.
    """
    by.require_organizer()
    worker = find(session, worker_id)
    if worker.state is WorkerState.STOPPED:
        raise ServiceError(ProblemCode.INVALID_REQUEST, f"Worker {worker_id} has ended; it takes no orders.")
    before = {"order": worker.worker_order.value}
    worker.worker_order = order
    session.flush()
    record(session, by, "worker.order", f"worker:{worker.id}", {"order": order.value}, before=before)
    return worker


def running_shards(session: Session) -> Mapping[UUID, Sequence[int]]:
    """Return the shards that run, by worker."""
    shards: dict[UUID, list[int]] = {}
    running = select(Shard.worker_id, Shard.id).where(Shard.state == WorkState.RUNNING).order_by(Shard.id)
    for worker_id, shard_id in session.execute(running):
        if worker_id is not None:
            shards.setdefault(worker_id, []).append(shard_id)
    return shards


def worker_view(worker: Worker, settings: Settings, *, now: datetime, shards: Sequence[int]) -> WorkerView:
    """Return a worker as organizers see it."""
    columns = {name: getattr(worker, name) for name in WorkerView.model_fields.keys() - {"is_lost", "shards"}}
    is_late = now - worker.heartbeat_at > timedelta(seconds=settings.worker_lost_after_s)
    is_lost = is_late and worker.state is not WorkerState.STOPPED
    return WorkerView(**columns, is_lost=is_lost, shards=list(shards))


OWN_SOURCES = ""
"""Stands in place of a track for the version of our own sources."""


def versions_here() -> dict[str, str]:
    """Return the versions of this process, by track."""
    return {OWN_SOURCES: evaluator_version(), **{track: find_version(track) for track in list_tracks()}}


def declare(session: Session, versions: Mapping[str, str], outdated: OutdatedRule = OutdatedRule.RESTART) -> None:
    """Store that the service evaluates with these versions, and what becomes of evaluations of others."""
    session.execute(delete(DeclaredEvaluator).where(DeclaredEvaluator.track.not_in(versions)))
    for track, version in sorted(versions.items()):
        session.merge(DeclaredEvaluator(track=track, version=version, outdated=outdated))


def declared_versions(session: Session) -> dict[str, str]:
    """Return the declared versions by track; none where no server has run yet."""
    return {row.track: row.version for row in session.scalars(select(DeclaredEvaluator))}


def read_outdated_rule(session: Session) -> OutdatedRule:
    """Return what becomes of evaluations of another version than the declared one."""
    rule = session.scalar(select(DeclaredEvaluator.outdated).where(DeclaredEvaluator.track == OWN_SOURCES))
    return rule or OutdatedRule.RESTART


def explain_left_work(session: Session) -> str | None:
    """Return what a worker of another evaluator than the declared one still does; None if it has nothing to do."""
    own = exists().where(
        Evaluation.evaluator_version.in_(current_versions()), Evaluation.state.in_(ACTIVE_EVALUATION_STATES)
    )
    if read_outdated_rule(session) is not OutdatedRule.FINISH or not session.scalar(select(own)):
        return None
    return f"Finishes what began with evaluator {evaluator_version()}; the service has another one now."


def explain_other_evaluator(declared: Mapping[str, str]) -> str | None:
    """Return why a worker with the sources of this process may take no shard of the service; None if it may."""
    expected, got = declared.get(OWN_SOURCES), evaluator_version()
    if expected is None or expected == got:
        return None
    return (
        f"This worker has evaluator {got}, the service {expected}: it takes no shards. Install the release of the "
        "service on this machine and start the worker again."
    )


def explain_other_tracks(declared: Mapping[str, str]) -> dict[str, str]:
    """Return by track why a worker with the track files of this process gets none of its shards."""
    own_sources, here = declared.get(OWN_SOURCES), versions_here()
    return {
        track: f"{track}: the service has version {version} of it, this worker {here.get(track, 'none')}. Give it the "
        "same files in VITAC_TRACKS_DIR, and the same packages of its tasks."
        for track, version in sorted(declared.items())
        if version != own_sources and here.get(track) != version
    }
