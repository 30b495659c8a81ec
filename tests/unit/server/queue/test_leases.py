import threading
from collections.abc import Callable
from uuid import uuid4

import pytest
from service_factories import claim, finish, make_principal, make_record, shard_ids, store, submit, take_away
from sqlalchemy import text
from sqlalchemy.orm import Session
from vitac.server.database.engine import Database
from vitac.server.database.models import Shard
from vitac.server.database.states import ShardState
from vitac.server.queue import leases
from vitac.server.queue.leases import Lease, LeaseLost


@pytest.fixture
def shard_id(database: Database) -> int:
    with database.transaction() as session:
        return shard_ids(session, submit(session, make_principal(session)))[0]


def try_claim(database: Database, shard_id: int) -> Lease | None:
    with database.transaction() as session:
        return leases.claim(session, shard_id, uuid4(), 60.0)


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


def test_a_shard_of_another_evaluator_is_not_claimed(database: Database, shard_id: int) -> None:
    with database.transaction() as session:
        session.execute(text("UPDATE evaluations SET evaluator_version = 'yesterday'"))
    assert try_claim(database, shard_id) is None


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


def test_shard_handed_back_waits_again_and_costs_no_attempt(database: Database, shard_id: int) -> None:
    with database.transaction() as session:
        session.execute(text("DELETE FROM procrastinate_jobs"))
    lease = claim(database, shard_id)
    in_transaction(database, lambda session: leases.hand_back(session, lease, counts_as_attempt=False))
    with database.transaction() as session:
        shard = session.get_one(Shard, shard_id)
        assert (shard.state, shard.attempts, shard.token) == (ShardState.QUEUED, 0, 1)
        assert session.scalar(text("SELECT count(*) FROM procrastinate_jobs WHERE status = 'todo'")) == 1
