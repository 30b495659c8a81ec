from datetime import timedelta
from pathlib import Path
from uuid import uuid4

import pytest
from service_factories import claim, make_principal, make_record, make_settings, shard_ids, store, submit
from sqlalchemy import func, update
from sqlalchemy.orm import Session
from vitac.evaluator.version import evaluator_version
from vitac.server.database.engine import Database
from vitac.server.database.metrics import totals
from vitac.server.database.models import EpisodeResult, Evaluation, Work, Worker
from vitac.server.database.states import WorkerState
from vitac.server.operations.state import operations
from vitac.server.settings import Settings
from vitac.server.views.operations import OperationsView


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    return make_settings(state_dir=tmp_path)


def look(database: Database, settings: Settings) -> OperationsView:
    with database.transaction() as session:
        return operations(session, settings, totals(session))


def add_worker(session: Session, state: WorkerState, *, seen_ago: timedelta = timedelta(0)) -> None:
    session.add(
        Worker(
            id=uuid4(), host="machine", pid=1, slots=2, state=state, evaluator_version=evaluator_version(),
            platform_class="x86_64-linux", isolation="user: root", heartbeat_at=func.clock_timestamp() - seen_ago,
        )
    )  # fmt: skip


def test_empty_service_has_nothing_that_waits(database: Database, settings: Settings) -> None:
    found = look(database, settings)
    assert (found.queue.shards_queued, found.queue.shards_running) == (0, 0)
    assert (found.queue.oldest_shard_s, found.queue.oldest_evaluation_s) == (None, None)
    assert (found.storage.uploads, found.storage.uploads_bytes) == (0, 0)
    assert found.storage.database_bytes > 1 << 20
    assert (found.workers, found.episodes_in_5_minutes) == ([], 0)


def test_queue_is_counted_with_the_age_of_what_waits_longest(database: Database, settings: Settings) -> None:
    with database.transaction() as session:
        principal = make_principal(session)
        first, second = (submit(session, principal, name) for name in ("first", "second"))
        shards = shard_ids(session, first)
        n_shards = len(shards) + len(shard_ids(session, second))
    with database.transaction() as session:
        ago = func.clock_timestamp() - timedelta(minutes=10)
        session.execute(update(Work).where(Work.id == shards[1]).values(queued_at=ago))
        session.execute(update(Evaluation).where(Evaluation.submission_id == second.id).values(created_at=ago))
    claim(database, shards[0])
    queue = look(database, settings).queue
    assert (queue.shards_queued, queue.shards_running) == (n_shards - 1, 1)
    assert (queue.evaluations_queued, queue.evaluations_running) == (1, 1)
    assert queue.oldest_shard_s == pytest.approx(600, abs=60)
    assert queue.oldest_evaluation_s == pytest.approx(600, abs=60)


def test_uploads_are_counted_once_for_each_stored_file(database: Database, settings: Settings) -> None:
    with database.transaction() as session:
        for team, content in (("A", "same"), ("B", "same"), ("B", "other")):
            submit(session, make_principal(session, f"{team} {content}"), content)
    storage = look(database, settings).storage
    assert (storage.uploads, storage.uploads_bytes) == (2, 200)


def test_only_recent_episodes_count(database: Database, settings: Settings) -> None:
    with database.transaction() as session:
        submission = submit(session, make_principal(session))
        first = shard_ids(session, submission)[0]
    lease = claim(database, first)
    store(database, lease, [make_record(episode) for episode in lease.episodes[:3]])
    with database.transaction() as session:
        session.execute(
            update(EpisodeResult)
            .where(EpisodeResult.episode == lease.episodes[0])
            .values(created_at=func.clock_timestamp() - timedelta(minutes=6))
        )
    assert look(database, settings).episodes_in_5_minutes == 2


@pytest.mark.parametrize(
    ("state", "seen_ago_s", "is_lost"),
    [(WorkerState.READY, 1, False), (WorkerState.READY, 60, True), (WorkerState.STOPPED, 60, False)],
)
def test_worker_without_heartbeat_that_did_not_report_its_end_is_lost(
    database: Database, settings: Settings, state: WorkerState, seen_ago_s: float, is_lost: bool
) -> None:
    with database.transaction() as session:
        add_worker(session, state, seen_ago=timedelta(seconds=seen_ago_s))
        add_worker(session, state, seen_ago=timedelta(hours=2))
    assert [entry.is_lost for entry in look(database, settings).workers] == [is_lost]


def test_a_shard_without_progress_is_seen_however_busy_the_others_are(database: Database, settings: Settings) -> None:
    with database.transaction() as session:
        submission = submit(session, make_principal(session))
        first, second = shard_ids(session, submission)[:2]
    hanging, busy = claim(database, first), claim(database, second)
    with database.transaction() as session:
        session.execute(update(Work).values(progressed_at=func.clock_timestamp() - timedelta(minutes=2)))
    store(database, busy, [make_record(busy.episodes[0])])
    assert look(database, settings).queue.shard_idle_s == pytest.approx(120, abs=60)
    store(database, hanging, [make_record(hanging.episodes[0])])
    assert look(database, settings).queue.shard_idle_s == pytest.approx(0, abs=60)
