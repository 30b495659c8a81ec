from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from asked_playbacks import SETTINGS, Played
from sqlalchemy import text, update
from sqlalchemy.orm import Session
from submission_steps import make_worker
from vitac.server.database.engine import Database
from vitac.server.database.models import Playback
from vitac.server.database.states import PlaybackState, WorkerState
from vitac.server.playbacks import work
from vitac.server.playbacks.work import PlaybackLease, recover, remove_old, stored_digests
from vitac.server.queue.jobs import MAKE_PLAYBACK
from vitac.server.queue.leases import LeaseLost

LONG_S = 60.0
FILES = {"scene_sha256": "1" * 64, "still_sha256": "2" * 64}


@pytest.fixture
def lease(team_a: Played) -> PlaybackLease:
    return claimed(team_a.database, team_a.ask(1).id)


def claimed(database: Database, playback_id: int, lease_s: float = LONG_S) -> PlaybackLease:
    with database.transaction() as session:
        lease = work.claim(session, playback_id, lease_s)
    assert lease is not None
    return lease


def row(team_a: Played, number: int = 1) -> Playback:
    found = team_a.found(number)
    assert found is not None
    return found


def waiting_jobs(database: Database) -> int:
    query = text("SELECT count(*) FROM procrastinate_jobs WHERE status = 'todo' AND task_name = :task")
    with database.transaction() as session:
        return int(session.scalar(query, {"task": MAKE_PLAYBACK}) or 0)


def drop_jobs(database: Database, status: str = "todo") -> None:
    with database.transaction() as session:
        session.execute(text("DELETE FROM procrastinate_jobs WHERE status::text = :status"), {"status": status})


def let_expire(team_a: Played) -> None:
    with team_a.database.transaction() as session:
        session.execute(update(Playback).values(lease_expires_at=datetime.now(UTC) - timedelta(seconds=1)))


def recovered(team_a: Played) -> int:
    with team_a.database.transaction() as session:
        return recover(session, SETTINGS)


def test_a_claim_gives_the_record_and_is_the_only_one(team_a: Played, lease: PlaybackLease) -> None:
    assert lease.record.episode == 1
    assert lease.record.record_digest() == team_a.episode().record_digest
    assert (lease.track, lease.attempt, lease.token) == ("track_1", 1, 1)
    with team_a.database.transaction() as session:
        assert work.claim(session, lease.playback_id, LONG_S) is None
        assert work.claim(session, 10**9, LONG_S) is None


def test_renewing_says_how_far_it_is(team_a: Played, lease: PlaybackLease) -> None:
    before = row(team_a).lease_expires_at
    with team_a.database.transaction() as session:
        work.renew(session, lease, 2 * LONG_S, env_steps_played=2)
    after = row(team_a)
    assert after.env_steps_played == 2
    assert before is not None
    assert after.lease_expires_at is not None
    assert after.lease_expires_at > before


def test_a_made_one_has_its_files_and_is_final(team_a: Played, lease: PlaybackLease) -> None:
    with team_a.database.transaction() as session:
        work.end_made(session, lease, FILES)
    made = row(team_a)
    assert made.state is PlaybackState.MADE
    assert (made.scene_sha256, made.cameras_sha256, made.still_sha256) == ("1" * 64, None, "2" * 64)
    assert made.env_steps_played == 3
    with team_a.database.transaction() as session:
        assert stored_digests(session) == set(FILES.values())
    with pytest.raises(LeaseLost), team_a.database.transaction() as session:
        work.end_failed(session, lease, "too late")


def test_a_failed_one_says_why(team_a: Played, lease: PlaybackLease) -> None:
    with team_a.database.transaction() as session:
        work.end_failed(session, lease, "The states differ.")
    assert row(team_a).state is PlaybackState.FAILED
    assert row(team_a).problem == "The states differ."


@pytest.mark.parametrize(("counts", "attempts"), [(True, 1), (False, 0)])
def test_one_that_is_handed_back_waits_again(team_a: Played, lease: PlaybackLease, counts: bool, attempts: int) -> None:
    drop_jobs(team_a.database)
    with team_a.database.transaction() as session:
        work.hand_back(session, lease, counts_as_attempt=counts)
    assert row(team_a).state is PlaybackState.QUEUED
    assert row(team_a).attempts == attempts
    assert waiting_jobs(team_a.database) == 1


def test_who_lost_the_lease_changes_nothing(team_a: Played, lease: PlaybackLease) -> None:
    let_expire(team_a)
    assert recovered(team_a) == 1
    newer = claimed(team_a.database, lease.playback_id)
    assert newer.token > lease.token
    changes: tuple[Callable[[Session], None], ...] = (
        lambda session: work.renew(session, lease, LONG_S, env_steps_played=1),
        lambda session: work.end_made(session, lease, FILES),
        lambda session: work.hand_back(session, lease, counts_as_attempt=False),
    )
    for change in changes:
        with pytest.raises(LeaseLost), team_a.database.transaction() as session:
            change(session)
    assert row(team_a).state is PlaybackState.RUNNING


def test_a_lost_one_is_queued_again_and_given_up_at_last(team_a: Played, lease: PlaybackLease) -> None:
    for _ in range(SETTINGS.shard_attempts - 1):
        let_expire(team_a)
        assert recovered(team_a) == 1
        assert row(team_a).state is PlaybackState.QUEUED
        claimed(team_a.database, lease.playback_id)
    let_expire(team_a)
    recovered(team_a)
    assert row(team_a).state is PlaybackState.FAILED
    assert "started 3 times" in (row(team_a).problem or "")


def test_one_with_a_good_lease_is_left_alone(team_a: Played, lease: PlaybackLease) -> None:
    assert recovered(team_a) == 0
    assert row(team_a).token == lease.token


def test_one_whose_job_was_lost_gets_another_after_a_while(team_a: Played) -> None:
    playback = team_a.ask(1)
    drop_jobs(team_a.database)
    recovered(team_a)
    assert waiting_jobs(team_a.database) == 0
    with team_a.database.transaction() as session:
        long_ago = datetime.now(UTC) - timedelta(minutes=5)
        session.execute(update(Playback).where(Playback.id == playback.id).values(asked_at=long_ago))
    recovered(team_a)
    recovered(team_a)
    assert waiting_jobs(team_a.database) == 1


@pytest.mark.parametrize(
    ("asked", "heartbeat", "worker", "state"),
    [
        (61, None, {}, PlaybackState.FAILED),
        (59, None, {}, PlaybackState.QUEUED),
        (999, 0, {}, PlaybackState.QUEUED),
        (999, 59, {"state": WorkerState.STOPPED}, PlaybackState.QUEUED),
        (999, 61, {}, PlaybackState.FAILED),
        (61, 0, {"state": WorkerState.REFUSING}, PlaybackState.FAILED),
        (61, 0, {"evaluator_version": "0+other"}, PlaybackState.FAILED),
    ],
)
def test_one_is_given_up_when_for_an_hour_there_was_no_worker_that_can_make_it(
    team_a: Played, asked: int, heartbeat: int | None, worker: dict[str, Any], state: PlaybackState
) -> None:
    team_a.ask(1)
    now = datetime.now(UTC)
    if heartbeat is not None:
        make_worker(team_a.database, heartbeat_at=now - timedelta(minutes=heartbeat), **worker)
    with team_a.database.transaction() as session:
        session.execute(update(Playback).values(asked_at=now - timedelta(minutes=asked)))
    recovered(team_a)
    found = row(team_a)
    assert found.state is state
    gave_up = state is PlaybackState.FAILED
    assert (found.finished_at is not None, found.problem is not None) == (gave_up, gave_up)
    if gave_up:
        with team_a.database.transaction() as session:
            assert work.claim(session, found.id, LONG_S) is None


def test_jobs_of_dead_workers_are_forgotten_once_nobody_holds_the_playback(
    team_a: Played, lease: PlaybackLease
) -> None:
    with team_a.database.transaction() as session:
        session.execute(text("UPDATE procrastinate_jobs SET status = 'doing' WHERE task_name = 'make_playback'"))
    recovered(team_a)
    assert running_jobs(team_a.database) == 1
    with team_a.database.transaction() as session:
        work.end_failed(session, lease, "no")
    recovered(team_a)
    assert running_jobs(team_a.database) == 0


def running_jobs(database: Database) -> int:
    query = text("SELECT count(*) FROM procrastinate_jobs WHERE status = 'doing' AND task_name = 'make_playback'")
    with database.transaction() as session:
        return int(session.scalar(query) or 0)


def test_old_ones_are_removed_but_not_those_in_the_queue(team_a: Played, lease: PlaybackLease) -> None:
    with team_a.database.transaction() as session:
        work.end_made(session, lease, FILES)
    team_a.ask(2)
    with team_a.database.transaction() as session:
        remove_old(session, SETTINGS)
        assert session.query(Playback).count() == 2
        session.execute(update(Playback).values(asked_at=datetime.now(UTC) - timedelta(days=31)))
        remove_old(session, SETTINGS)
    assert team_a.found(1) is None
    assert row(team_a, 2).state is PlaybackState.QUEUED
