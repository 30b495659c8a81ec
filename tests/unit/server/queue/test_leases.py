from collections.abc import Callable

import pytest
from service_factories import claim, finish, make_principal, make_record, shard_ids, store, submit, take, take_away
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session
from vitac.server.database.engine import Database
from vitac.server.database.models import Shard
from vitac.server.database.states import EvaluationState, WorkState
from vitac.server.principals import CONSOLE
from vitac.server.queue import leases, work
from vitac.server.queue.work import LeaseLost
from vitac.server.submissions import runs


@pytest.fixture
def shard_id(database: Database) -> int:
    with database.transaction() as session:
        return shard_ids(session, submit(session, make_principal(session)))[0]


def in_transaction(database: Database, change: Callable[[Session], object]) -> None:
    with database.transaction() as session:
        change(session)


def test_worker_that_wakes_up_late_cannot_renew_store_finish_or_hand_back(database: Database, shard_id: int) -> None:
    late = claim(database, shard_id)
    take_away(database, shard_id)
    new = claim(database, shard_id)
    assert new.token > late.token
    attempts: tuple[Callable[[], None], ...] = (
        lambda: store(database, late, [make_record(1)]),
        lambda: finish(database, late),
        lambda: in_transaction(database, lambda session: work.renew(session, late, 60.0)),
        lambda: in_transaction(database, lambda session: work.hand_back(session, late)),
    )
    for attempt in attempts:
        with pytest.raises(LeaseLost, match=f"shard {shard_id} is no longer held under token 1"):
            attempt()
    store(database, new, (make_record(episode) for episode in new.episodes))
    finish(database, new)


def test_what_was_cancelled_after_its_claim_is_not_begun(database: Database, shard_id: int) -> None:
    with database.transaction() as session:
        claimed = take(session, shard_id)
    with database.transaction() as session:
        evaluation = session.get_one(Shard, shard_id).evaluation
        runs.cancel(session, CONSOLE, evaluation.submission_id)
    with pytest.raises(LeaseLost), database.transaction() as session:
        leases.begin(session, claimed)
    with database.transaction() as session:
        assert session.get_one(Shard, shard_id).evaluation.state is EvaluationState.CANCELLED


def test_shard_handed_back_waits_again_and_costs_no_attempt(database: Database, shard_id: int) -> None:
    lease = claim(database, shard_id)
    in_transaction(database, lambda session: work.hand_back(session, lease))
    with database.transaction() as session:
        shard = session.get_one(Shard, shard_id)
        assert (shard.state, shard.attempts, shard.token) == (WorkState.QUEUED, 0, 1)


def test_work_is_not_done_without_its_result(database: Database, shard_id: int) -> None:
    lease = claim(database, shard_id)
    with pytest.raises(IntegrityError, match="done without a result"), database.transaction() as session:
        work.end(session, lease, WorkState.DONE)


def test_what_is_removed_with_its_evaluation_leaves_the_queue(database: Database, shard_id: int) -> None:
    with database.transaction() as session:
        before = work.count_open(session)
        session.connection().exec_driver_sql("DELETE FROM shards")
        assert (before > 0, work.count_open(session)) == (True, 0)
