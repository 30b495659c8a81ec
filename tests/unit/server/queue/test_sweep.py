import threading
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from database_work import database_work
from service_factories import (
    claim,
    make_principal,
    make_record,
    make_settings,
    play,
    state_of,
    store,
    submit,
)
from sqlalchemy import text, update
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session
from submission_steps import ids_of
from vitac.server.database.engine import Database
from vitac.server.database.locks import AdvisoryLock
from vitac.server.database.models import Shard, Submission, Team, Webhook, Work
from vitac.server.database.states import EvaluationState, WorkKind, WorkState
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.lifecycle import give_up
from vitac.server.queue import work
from vitac.server.queue.work import IDLE_LIMIT, KINDS, LeaseLost, Sweep, lock_held, sweep
from vitac.server.settings import Settings

SETTINGS = make_settings(lease_s=0.003, lease_renewal_s=0.001)
"""Leases that have run out by the time of the next statement."""


def run_sweep(database: Database, settings: Settings = SETTINGS) -> Sweep:
    with database.transaction() as session:
        session.execute(text("SELECT pg_sleep(0.01)"))
        session.execute(text("SET LOCAL statement_timeout = '60s'"))  # else a sweep that waits would hang the test
        return sweep(session, settings, give_up=give_up)


def test_shard_with_an_expired_lease_is_queued_again_and_its_worker_fenced_off(
    database: Database, submission: Submission
) -> None:
    first = ids_of(database, submission)[0]
    lost = claim(database, first, lease_s=0.001)
    assert run_sweep(database).queued_again == 1
    with pytest.raises(LeaseLost):
        store(database, lost, [make_record(1)])
    play(database, first)


@pytest.mark.parametrize(("kind", "attempts"), [(WorkKind.TRIAL, 0), (WorkKind.SHARD, 1)])
def test_lost_worker_is_noted_and_costs_a_trial_of_a_station_no_attempt_up_to_a_limit(
    database: Database, submission: Submission, monkeypatch: pytest.MonkeyPatch, kind: WorkKind, attempts: int
) -> None:
    trial = replace(KINDS[WorkKind.TRIAL], free_repeats=SETTINGS.shard_attempts)
    monkeypatch.setattr(work, "KINDS", {**KINDS, WorkKind.TRIAL: trial})
    first = ids_of(database, submission)[0]
    with database.transaction() as session:
        session.execute(text("UPDATE work SET kind = :kind WHERE id = :id"), {"kind": kind, "id": first})
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


@pytest.mark.parametrize(
    ("kind", "is_free", "state"),
    [(WorkKind.TRIAL, True, "queued"), (WorkKind.TRIAL, False, "cancelled"), (WorkKind.SHARD, True, "cancelled")],
)
def test_devices_with_faults_end_no_trial(
    database: Database,
    submission: Submission,
    monkeypatch: pytest.MonkeyPatch,
    kind: WorkKind,
    is_free: bool,
    state: str,
) -> None:
    monkeypatch.setattr(work, "RETRY_DELAY_S", 0.0)
    first = ids_of(database, submission)[0]
    with database.transaction() as session:
        session.execute(text("UPDATE work SET kind = :kind WHERE id = :id"), {"kind": kind, "id": first})
    for number in range(SETTINGS.shard_attempts):
        held = claim(database, first)
        with database.transaction() as session:
            work.report_broken(session, SETTINGS, held, f"fault {number}", give_up=give_up, is_free=is_free)
    with database.transaction() as session:
        assert session.get_one(Shard, first).state == state


def test_a_station_has_an_hour_to_be_mended_before_an_evaluation_ends() -> None:
    assert [work._retry_delay_s(attempts, attempts - 1) for attempts in (1, 2)] == [2.0, 4.0]
    free = KINDS[WorkKind.TRIAL].free_repeats
    assert sum(work._retry_delay_s(0, repeats) for repeats in range(4)) < 20.0
    assert sum(work._retry_delay_s(0, repeats) for repeats in range(free)) > 3600.0


def test_shard_with_a_living_lease_is_left_alone(database: Database, submission: Submission) -> None:
    first = ids_of(database, submission)[0]
    claim(database, first, lease_s=60.0)
    assert run_sweep(database).queued_again == 0
    with database.transaction() as session:
        assert state_of(session, first) is WorkState.RUNNING


def test_right_after_a_restart_of_the_database_workers_get_time_to_renew(
    database: Database, submission: Submission
) -> None:
    first = ids_of(database, submission)[0]
    claim(database, first, lease_s=0.001)
    long_lease = make_settings(lease_s=86400.0)
    assert run_sweep(database, long_lease).queued_again == 0


def test_a_process_that_stands_still_with_a_lock_keeps_no_other_shard_from_being_found(
    database: Database, submission: Submission
) -> None:
    with database.transaction() as session:
        other = submit(session, make_principal(session, "Team B"), "other")
    first, second = ids_of(database, submission)[0], ids_of(database, other)[0]
    lost = [claim(database, shard, lease_s=0.001) for shard in (first, second)]
    with database.transaction() as stuck:
        lock_held(stuck, lost[0])
        assert run_sweep(database) == Sweep(queued_again=1)
        with database.transaction() as session:
            assert [state_of(session, shard) for shard in (first, second)] == [WorkState.RUNNING, WorkState.QUEUED]
    assert run_sweep(database).queued_again == 1


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
        session.execute(update(Work).where(Work.id == first).values(last))
    with database.transaction() as stuck:
        stuck.get_one(held, sibling if held is Shard else submission.team_id, with_for_update=True)
        assert run_sweep(database) == Sweep(queued_again=1)
        with database.transaction() as session:
            assert [state_of(session, shard) for shard in lost] == [WorkState.RUNNING, WorkState.QUEUED]
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
        assert sweep(stopped, SETTINGS, give_up=give_up).queued_again == 1
        assert stopped.scalar(text("SHOW idle_in_transaction_session_timeout")) == IDLE_LIMIT
        stopped.execute(text("SET LOCAL idle_in_transaction_session_timeout = '20ms'"))
        ended = threading.Event()
        while run_sweep(database) == Sweep():
            ended.wait(0.02)
        with pytest.raises(DBAPIError):
            stopped.execute(text("SELECT 1"))
    with database.transaction() as session:
        assert state_of(session, shard) is WorkState.QUEUED


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
        assert "Episodes 1 to 27 of peg-insertion: Started 3 times" in (evaluation.verdict_message or "")
        assert {shard.state for shard in evaluation.shards} == {WorkState.CANCELLED}


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


def test_two_sweeps_at_once_do_the_work_of_one(database: Database, submission: Submission) -> None:
    claim(database, ids_of(database, submission)[0], lease_s=0.001)
    with database.transaction() as session:
        session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": AdvisoryLock.SWEEP})
        assert run_sweep(database) == Sweep()
    assert run_sweep(database) == Sweep(queued_again=1)


def test_a_sweep_reads_only_what_runs(database: Database, submission: Submission) -> None:
    many = 2000
    more = """
        INSERT INTO work (kind, owner, requires, priority)
        SELECT 'shard', 'team', 'nobody', 5 FROM generate_series(1, :many)
    """
    with database.transaction() as session:
        session.execute(text(more), {"many": many})
    with database.transaction() as session:
        session.execute(text("ANALYZE work"))
        with database_work(session) as done:
            assert sweep(session, SETTINGS, give_up=give_up) == Sweep()
    assert done.rows_read["work"] <= 2 * many
