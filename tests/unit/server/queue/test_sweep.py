import threading
from datetime import UTC, datetime, timedelta

import pytest
from database_work import database_work
from service_factories import (
    claim,
    make_principal,
    make_record,
    make_settings,
    play,
    shard_ids,
    state_of,
    store,
    submit,
)
from sqlalchemy import select, text, update
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family
from vitac.server.database.engine import Database
from vitac.server.database.locks import AdvisoryLock, lock_evaluation
from vitac.server.database.models import Shard, Submission, Team, Webhook
from vitac.server.database.states import EvaluationState, ShardState
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.lifecycle import fail_by_machines
from vitac.server.queue import sweep as sweep_module
from vitac.server.queue.jobs import (
    enqueue_shards,
    forget_jobs_of_ended_shards,
    prune_finished_jobs,
    queue_name,
    withdraw_jobs,
)
from vitac.server.queue.leases import LeaseLost, lock_held
from vitac.server.queue.sweep import IDLE_LIMIT, Sweep, sweep
from vitac.server.settings import Settings

SETTINGS = make_settings(lease_s=0.003, lease_renewal_s=0.001)
"""Leases that have run out by the time of the next statement."""


@pytest.fixture
def submission(database: Database) -> Submission:
    with database.transaction() as session:
        return submit(session, make_principal(session))


def ids_of(database: Database, submission: Submission) -> list[int]:
    with database.transaction() as session:
        return shard_ids(session, submission)


def run_sweep(database: Database, settings: Settings = SETTINGS) -> Sweep:
    with database.transaction() as session:
        session.execute(text("SELECT pg_sleep(0.01)"))
        session.execute(text("SET LOCAL statement_timeout = '60s'"))  # else a sweep that waits would hang the test
        return sweep(session, settings, give_up=fail_by_machines)


def jobs(database: Database, status: str = "todo") -> list[int]:
    query = "SELECT (args ->> 'shard_id')::bigint FROM procrastinate_jobs WHERE status::text = :status"
    with database.transaction() as session:
        return sorted(session.execute(text(query), {"status": status}).scalars())


def forget_jobs(database: Database) -> None:
    with database.transaction() as session:
        session.execute(text("DELETE FROM procrastinate_jobs"))


def test_shard_with_an_expired_lease_is_queued_again_and_its_worker_fenced_off(
    database: Database, submission: Submission
) -> None:
    first = ids_of(database, submission)[0]
    lost = claim(database, first, lease_s=0.001)
    forget_jobs(database)
    assert run_sweep(database).queued_again == 1
    assert first in jobs(database)
    with pytest.raises(LeaseLost):
        store(database, lost, [make_record(1)])
    play(database, first)


@pytest.mark.parametrize(("family", "attempts"), [(Family.STATION, 0), (Family.TACTILE, 1)])
def test_lost_worker_is_noted_and_costs_a_trial_of_a_station_no_attempt_up_to_a_limit(
    database: Database, submission: Submission, monkeypatch: pytest.MonkeyPatch, family: Family, attempts: int
) -> None:
    monkeypatch.setattr(sweep_module, "find_family", lambda *_: family)
    monkeypatch.setattr(sweep_module, "TRIAL_LOSSES", SETTINGS.shard_attempts)
    first = ids_of(database, submission)[0]
    claim(database, first, lease_s=0.001)
    assert run_sweep(database) == Sweep(queued_again=1)
    with database.transaction() as session:
        shard = session.get_one(Shard, first)
        assert (shard.attempts, [each["cause"] for each in shard.repeats]) == (attempts, ["lost"])
        assert str(shard.worker_id or "was lost") in shard.repeats[0]["reason"]
    given_up = 0
    for _ in range(2 * SETTINGS.shard_attempts):
        if not given_up:
            claim(database, first, lease_s=0.001)
            given_up = run_sweep(database).given_up
    assert given_up == 1


def test_shard_with_a_living_lease_is_left_alone(database: Database, submission: Submission) -> None:
    first = ids_of(database, submission)[0]
    claim(database, first, lease_s=60.0)
    assert run_sweep(database).queued_again == 0
    with database.transaction() as session:
        assert state_of(session, first) is ShardState.RUNNING


def test_right_after_a_restart_of_the_database_workers_get_time_to_renew(
    database: Database, submission: Submission
) -> None:
    first = ids_of(database, submission)[0]
    claim(database, first, lease_s=0.001)
    long_lease = make_settings(lease_s=86400.0)
    assert run_sweep(database, long_lease).queued_again == 0


@pytest.mark.parametrize("held", ["evaluation", "shard"])
def test_a_process_that_stands_still_with_a_lock_keeps_no_other_shard_from_being_found(
    database: Database, submission: Submission, held: str
) -> None:
    with database.transaction() as session:
        other = submit(session, make_principal(session, "Team B"), "other")
    first, second = ids_of(database, submission)[0], ids_of(database, other)[0]
    lost = [claim(database, shard, lease_s=0.001) for shard in (first, second)]
    forget_jobs(database)
    with database.transaction() as stuck:
        if held == "evaluation":
            lock_evaluation(stuck, lost[0].evaluation_id)
        else:
            lock_held(stuck, lost[0])
        done = run_sweep(database)
        assert (done.queued_again, done.given_up) == (1, 0)
        with database.transaction() as session:
            assert [state_of(session, shard) for shard in (first, second)] == [ShardState.RUNNING, ShardState.QUEUED]
    assert run_sweep(database).queued_again == 1
    assert set(jobs(database)) >= {first, second}


@pytest.mark.parametrize("held", [Shard, Team])
def test_an_evaluation_that_cannot_be_given_up_now_keeps_no_other_shard_from_being_found(
    database: Database, submission: Submission, held: type[Shard | Team]
) -> None:
    with database.transaction() as session:
        session.add(Webhook(team_id=submission.team_id, address="https://example.org", secret="0" * 64))
        other = submit(session, make_principal(session, "Team B"), "other")
    first, sibling = ids_of(database, submission)[:2]
    lost = (first, ids_of(database, other)[0])
    for shard in lost:
        claim(database, shard, lease_s=0.001)
    with database.transaction() as session:
        last = {"token": SETTINGS.shard_attempts, "attempts": SETTINGS.shard_attempts}
        session.execute(update(Shard).where(Shard.id == first).values(last))
    with database.transaction() as stuck:
        stuck.get_one(held, sibling if held is Shard else submission.team_id, with_for_update=True)
        assert run_sweep(database) == Sweep(queued_again=1)
        with database.transaction() as session:
            assert [state_of(session, shard) for shard in lost] == [ShardState.RUNNING, ShardState.QUEUED]
            assert newest_evaluation(session, submission).state is EvaluationState.RUNNING
    assert run_sweep(database) == Sweep(given_up=1)
    with database.transaction() as session:
        assert newest_evaluation(session, submission).state is EvaluationState.FAILED
        assert newest_evaluation(session, other).state is EvaluationState.RUNNING


def test_a_sweep_that_stands_still_is_ended_by_the_database_and_another_takes_over(
    database: Database, submission: Submission
) -> None:
    shard = ids_of(database, submission)[0]
    claim(database, shard, lease_s=0.001)
    with Session(database.engine) as stopped:
        assert sweep(stopped, SETTINGS, give_up=fail_by_machines).queued_again == 1
        assert stopped.scalar(text("SHOW idle_in_transaction_session_timeout")) == IDLE_LIMIT
        stopped.execute(text("SET LOCAL idle_in_transaction_session_timeout = '20ms'"))
        ended = threading.Event()
        while run_sweep(database) == Sweep():
            ended.wait(0.02)
        with pytest.raises(DBAPIError):
            stopped.execute(text("SELECT 1"))
    with database.transaction() as session:
        assert state_of(session, shard) is ShardState.QUEUED


def test_evaluation_fails_by_name_when_a_shard_was_lost_in_all_its_attempts(
    database: Database, submission: Submission
) -> None:
    first = ids_of(database, submission)[0]
    for _ in range(2):
        claim(database, first, lease_s=0.001)
        assert run_sweep(database).queued_again == 1
    claim(database, first, lease_s=0.001)
    assert run_sweep(database) == Sweep(given_up=1)
    with database.transaction() as session:
        evaluation = newest_evaluation(session, submission)
        assert evaluation.state is EvaluationState.FAILED
        assert evaluation.verdict_code == "machine_failed"
        assert "Episodes 1 to 27 of peg-insertion were started 3 times" in (evaluation.verdict_message or "")
        assert {shard.state for shard in evaluation.shards} == {ShardState.CANCELLED}
    assert jobs(database) == []


def test_shard_is_never_given_up_as_long_as_each_attempt_stores_an_episode(
    database: Database, submission: Submission
) -> None:
    first = ids_of(database, submission)[0]
    for episode in range(1, 7):
        lease = claim(database, first, lease_s=60.0)
        store(database, lease, [make_record(episode)])
        assert lose(database, first) == Sweep(queued_again=1)
    for _ in range(2):
        store(database, claim(database, first), [make_record(1)])  # stored before: no progress
        assert lose(database, first) == Sweep(queued_again=1)
    claim(database, first)
    assert lose(database, first) == Sweep(given_up=1)


def lose(database: Database, shard_id: int) -> Sweep:
    """Lets the lease of a shard run out, and sweeps."""
    with database.transaction() as session:
        session.get_one(Shard, shard_id).lease_expires_at = datetime.now(UTC) - timedelta(hours=1)
    return run_sweep(database)


def test_queued_shard_whose_job_was_lost_gets_a_new_one_once(database: Database, submission: Submission) -> None:
    forget_jobs(database)
    assert run_sweep(database).woken == 10
    assert jobs(database) == ids_of(database, submission)
    assert run_sweep(database).woken == 0


def test_job_that_was_just_taken_is_given_time_to_claim_its_shard(database: Database, submission: Submission) -> None:
    with database.transaction() as session:
        session.execute(text("UPDATE procrastinate_jobs SET status = 'doing'"))
        session.execute(text("UPDATE shards SET queued_at = now() - interval '1 day'"))
    assert run_sweep(database, make_settings(lease_s=60.0)).woken == 0
    with database.transaction() as session:
        session.execute(text("UPDATE procrastinate_events SET at = now() - interval '1 day'"))
    assert run_sweep(database, make_settings(lease_s=60.0)).woken == 10


def test_two_sweeps_at_once_do_the_work_of_one(database: Database, submission: Submission) -> None:
    forget_jobs(database)
    with database.transaction() as session:
        session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": AdvisoryLock.SWEEP})
        assert run_sweep(database) == Sweep()
    assert run_sweep(database).woken == 10


def test_jobs_left_running_by_a_dead_worker_are_forgotten(database: Database, submission: Submission) -> None:
    with database.transaction() as session:
        session.execute(text("UPDATE procrastinate_jobs SET status = 'doing'"))
    run_sweep(database)
    assert jobs(database, "doing") == []
    assert jobs(database) == ids_of(database, submission)


def test_finished_jobs_are_pruned_by_age(database: Database, submission: Submission) -> None:
    with database.transaction() as session:
        session.execute(text("UPDATE procrastinate_jobs SET status = 'doing'"))
        session.execute(text("UPDATE procrastinate_jobs SET status = 'succeeded'"))
    with database.transaction() as session:
        assert prune_finished_jobs(session, timedelta(hours=1)) == 0
        assert prune_finished_jobs(session, timedelta(0)) == 10


MANY = 2000


@pytest.fixture
def long_queue(database: Database, submission: Submission) -> Database:
    """A queue of many more shards than the nine of a submission, each with its job."""
    more = """
        INSERT INTO shards (evaluation_id, task, number, episodes, state, token, attempts)
        SELECT id, 'more', number, ARRAY[number], 'queued', 0, 0 FROM evaluations, generate_series(1, :many) number
    """
    with database.transaction() as session:
        session.execute(text(more), {"many": MANY})
        added = session.scalars(select(Shard.id).where(Shard.task == "more")).all()
        queue = queue_name(newest_evaluation(session, submission).evaluator_version)
        enqueue_shards(session, added, queue, priority=0)
    with database.transaction() as session:
        session.execute(text("ANALYZE"))
    return database


def test_work_of_a_sweep_grows_with_the_queue_and_not_with_its_square(long_queue: Database) -> None:
    with long_queue.transaction() as session:
        session.execute(text("SELECT pg_sleep(0.01)"))
        with database_work(session) as work:
            assert sweep(session, SETTINGS, give_up=fail_by_machines) == Sweep()
    assert work.rows_read["procrastinate_jobs"] < 5 * MANY
    assert work.rows_read["shards"] < 5 * MANY


def test_jobs_are_withdrawn_and_forgotten_without_reading_the_queue(
    long_queue: Database, submission: Submission
) -> None:
    ids = ids_of(long_queue, submission)[:10]
    with long_queue.transaction() as session, database_work(session) as work:
        withdraw_jobs(session, ids)
        forget_jobs_of_ended_shards(session)
    assert len(jobs(long_queue)) == MANY
    assert work.rows_read["procrastinate_jobs"] < 50
