import threading
from collections.abc import Callable
from uuid import uuid4

import pytest
from service_factories import claim, finish, make_principal, make_record, shard_ids, state_of, store, submit
from sqlalchemy import select, text
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeOutcome
from vitac.server.db.engine import Database
from vitac.server.db.models import EpisodeResult, Shard
from vitac.server.db.states import ShardState
from vitac.server.queue import leases
from vitac.server.queue.leases import Lease, LeaseLost


@pytest.fixture
def shard_id(database: Database) -> int:
    with database.transaction() as session:
        return shard_ids(session, submit(session, make_principal(session)))[0]


def try_claim(database: Database, shard_id: int) -> Lease | None:
    with database.transaction() as session:
        return leases.claim(session, shard_id, uuid4(), 60.0)


def take_away(database: Database, shard_id: int) -> None:
    """What the sweep does with a shard whose lease has run out."""
    with database.transaction() as session:
        shard = session.get_one(Shard, shard_id)
        shard.state, shard.lease_expires_at, shard.token = ShardState.QUEUED, None, shard.token + 1


def test_one_of_many_claims_at_once_gets_the_shard(database: Database, shard_id: int) -> None:
    got: list[Lease | None] = []
    barrier = threading.Barrier(8)

    def run() -> None:
        barrier.wait()
        got.append(try_claim(database, shard_id))

    threads = [threading.Thread(target=run) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len([lease for lease in got if lease is not None]) == 1
    assert len(got) == 8


def test_finished_or_unknown_shard_cannot_be_claimed(database: Database, shard_id: int) -> None:
    lease = claim(database, shard_id)
    store(database, lease, (make_record(episode) for episode in lease.episodes))
    finish(database, lease)
    assert try_claim(database, shard_id) is None
    assert try_claim(database, 10**9) is None


def test_worker_that_wakes_up_late_cannot_renew_store_finish_or_hand_back(database: Database, shard_id: int) -> None:
    late = claim(database, shard_id)
    take_away(database, shard_id)
    new = claim(database, shard_id)
    assert new.token > late.token
    attempts: tuple[Callable[[], None], ...] = (
        lambda: store(database, late, [make_record(1)]),
        lambda: finish(database, late),
        lambda: in_transaction(database, lambda session: leases.renew(session, late, 60.0)),
        lambda: in_transaction(database, lambda session: leases.hand_back(session, late, counts_as_attempt=False)),
    )
    for attempt in attempts:
        with pytest.raises(LeaseLost, match=f"Shard {shard_id}"):
            attempt()
    store(database, new, (make_record(episode) for episode in new.episodes))
    finish(database, new)


def in_transaction(database: Database, work: Callable[[Session], object]) -> None:
    with database.transaction() as session:
        work(session)


def test_episode_delivered_twice_is_one_row_and_the_first_one_counts(database: Database, shard_id: int) -> None:
    lease = claim(database, shard_id)
    store(database, lease, [make_record(1), make_record(1), make_record(1, EpisodeOutcome.STEPS)])
    with database.transaction() as session:
        rows = session.scalars(select(EpisodeResult)).all()
        assert [(row.episode, row.outcome) for row in rows] == [(1, "success")]


def test_stored_episodes_are_known_to_the_next_claim(database: Database, shard_id: int) -> None:
    store(database, claim(database, shard_id), [make_record(2), make_record(7)])
    take_away(database, shard_id)
    lease = claim(database, shard_id)
    with database.transaction() as session:
        stored = leases.stored_episodes(session, lease)
    assert stored.numbers == {2, 7}
    assert stored.failures == ()


def test_shard_handed_back_waits_again_and_costs_no_attempt(database: Database, shard_id: int) -> None:
    with database.transaction() as session:
        session.execute(text("DELETE FROM procrastinate_jobs"))
    lease = claim(database, shard_id)
    in_transaction(database, lambda session: leases.hand_back(session, lease, counts_as_attempt=False))
    with database.transaction() as session:
        shard = session.get_one(Shard, shard_id)
        assert (shard.state, shard.attempts, shard.token) == (ShardState.QUEUED, 0, 1)
        assert session.scalar(text("SELECT count(*) FROM procrastinate_jobs WHERE status = 'todo'")) == 1


def test_storing_and_cancelling_at_once_do_not_wait_for_each_other(database: Database, shard_id: int) -> None:
    lease = claim(database, shard_id)
    with database.transaction() as storing:
        leases.store_episode(storing, lease, make_record(1))
        with database.transaction() as locking:
            locking.execute(text("SET LOCAL lock_timeout = 2000"))
            leases.lock_evaluation(locking, lease.evaluation_id)
    with database.transaction() as session:
        assert state_of(session, shard_id) is ShardState.RUNNING
