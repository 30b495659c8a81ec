"""Reads the state of the service: queue, workers, storage. Called by `/metrics` and the page *Operations*.

Every query looks at what is open or recent only, or at one narrow table, so that a scrape stays cheap.
"""

from collections.abc import Collection, Iterator, Mapping
from datetime import datetime, timedelta
from enum import StrEnum
from typing import TypeVar

from sqlalchemy import func, select
from sqlalchemy.orm import InstrumentedAttribute, Session
from vitac.evaluator.tracks import list_tracks, load_track

from ..database.clock import read_clock
from ..database.metrics import SeriesKey
from ..database.models import EpisodeResult, Evaluation, Shard, Submission, Worker
from ..database.states import ACTIVE_EVALUATION_STATES, OPEN_WORK_STATES, EvaluationState, WorkState
from ..evaluations.superseding import is_unserved
from ..queue.workers import running_shards, worker_view
from ..settings import Settings
from ..views.operations import CountsView, OperationsView, QueueView, StorageView

SHARE = 0.95


def make_counts_view(totals: Mapping[SeriesKey, float]) -> CountsView:
    """Return the sums; what nobody has counted yet is zero."""
    requests = "vitac_request_seconds"
    failed = [
        value
        for key, value in totals.items()
        if key.name == f"{requests}_count" and key.label_values()["status"] == "5xx"
    ]
    return CountsView(
        episodes=_sum(totals, "vitac_episodes_total"),
        shards_finished=_sum(totals, "vitac_shards_finished_total"),
        shard_retries=_sum(totals, "vitac_shard_retries_total"),
        shards_given_up=_sum(totals, "vitac_shards_given_up_total"),
        leases_lost=_sum(totals, "vitac_leases_lost_total"),
        requests=_sum(totals, f"{requests}_count"),
        requests_failed=int(sum(failed)),
        requests_within_s=estimate_bound(totals, requests),
        claims_within_s=estimate_bound(totals, "vitac_claim_seconds"),
        shard_waits_within_s=estimate_bound(totals, "vitac_shard_wait_seconds"),
    )


def estimate_bound(totals: Mapping[SeriesKey, float], histogram: str) -> float | None:
    """Return the smallest bound of a bucket [s] that holds `SHARE` of all observations.

    None without observations; infinite if they took longer than the last bound.
    """
    buckets: dict[float, float] = {}
    for bound, count in _buckets(totals, f"{histogram}_bucket"):
        buckets[bound] = buckets.get(bound, 0.0) + count
    observed = buckets.get(float("inf"), 0.0)
    if not observed:
        return None
    return min(bound for bound, count in buckets.items() if count >= SHARE * observed)


def _buckets(totals: Mapping[SeriesKey, float], name: str) -> Iterator[tuple[float, float]]:
    for key, value in totals.items():
        if key.name == name:
            yield float(key.label_values()["le"]), value


def _sum(totals: Mapping[SeriesKey, float], name: str) -> int:
    return int(sum(value for key, value in totals.items() if key.name == name))


StateT = TypeVar("StateT", bound=StrEnum)

WORKERS_SHOWN_FOR = timedelta(hours=1)
RATE_WINDOW = timedelta(minutes=5)


def operations(session: Session, settings: Settings, counted: Mapping[SeriesKey, float]) -> OperationsView:
    """Return the state of the service, with a summary of the totals."""
    now = read_clock(session)
    shards = running_shards(session)
    recent = select(Worker).where(Worker.heartbeat_at > now - WORKERS_SHOWN_FOR).order_by(Worker.host, Worker.pid)
    return OperationsView(
        queue=_queue(session, settings, now),
        storage=_storage(session),
        workers=[
            worker_view(worker, settings, now=now, shards=shards.get(worker.id, ()))
            for worker in session.scalars(recent)
        ],
        episodes_in_5_minutes=_count_episodes(session, now - RATE_WINDOW),
        counts=make_counts_view(counted),
        at=now,
    )


def _queue(session: Session, settings: Settings, now: datetime) -> QueueView:
    shards = _open_rows(session, Shard.state, OPEN_WORK_STATES, Shard.queued_at)
    progressed_at = session.scalar(select(func.min(Shard.progressed_at)).where(Shard.state == WorkState.RUNNING))
    unserved = session.scalar(select(func.count()).select_from(Evaluation).where(is_unserved(settings)))
    evaluations = _open_rows(session, Evaluation.state, ACTIVE_EVALUATION_STATES, Evaluation.created_at)
    return QueueView(
        shards_queued=shards.get(WorkState.QUEUED, (0, now))[0],
        shards_running=shards.get(WorkState.RUNNING, (0, now))[0],
        oldest_shard_s=_age_s(shards.get(WorkState.QUEUED), now),
        shard_idle_s=None if progressed_at is None else _age_s((1, progressed_at), now),
        evaluations_queued=evaluations.get(EvaluationState.QUEUED, (0, now))[0],
        evaluations_running=evaluations.get(EvaluationState.RUNNING, (0, now))[0],
        oldest_evaluation_s=_age_s(evaluations.get(EvaluationState.QUEUED), now),
        evaluations_unserved=unserved or 0,
    )


def _open_rows(
    session: Session,
    state: InstrumentedAttribute[StateT],
    open_states: Collection[StateT],
    since: InstrumentedAttribute[datetime],
) -> dict[StateT, tuple[int, datetime]]:
    """Return number and first time of the rows in each open state that has any."""
    rows = session.execute(select(state, func.count(), func.min(since)).where(state.in_(open_states)).group_by(state))
    return {work_state: (count, first) for work_state, count, first in rows}


def _age_s(oldest: tuple[int, datetime] | None, now: datetime) -> float | None:
    return None if oldest is None else max(0.0, (now - oldest[1]).total_seconds())


def _storage(session: Session) -> StorageView:
    files = (
        select(Submission.archive_sha256, func.max(Submission.archive_bytes).label("size"))
        .group_by(Submission.archive_sha256)
        .subquery()
    )
    uploads, uploads_bytes, database_bytes = session.execute(
        select(
            func.count(),
            func.coalesce(func.sum(files.c.size), 0),
            func.pg_database_size(func.current_database()),
        ).select_from(files)
    ).one()
    return StorageView(uploads=uploads, uploads_bytes=int(uploads_bytes), database_bytes=database_bytes)


def _count_episodes(session: Session, moment: datetime) -> int:
    tasks = {task for track in list_tracks() for task in load_track(track).tasks}  # named, so that the index is used
    query = select(func.count()).where(EpisodeResult.task.in_(tasks), EpisodeResult.created_at > moment)
    return session.scalars(query).one()
