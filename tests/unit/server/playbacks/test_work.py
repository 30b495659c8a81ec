from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from asked_playbacks import SETTINGS, Played
from service_factories import take
from sqlalchemy import update
from sqlalchemy.orm import Session
from submission_steps import make_worker
from vitac.server.database.engine import Database
from vitac.server.database.models import Playback, Work
from vitac.server.database.states import WorkerState, WorkState
from vitac.server.evaluations.lifecycle import give_up
from vitac.server.playbacks import work
from vitac.server.playbacks.work import PlaybackLease, remove_old, stored_digests
from vitac.server.queue.work import LeaseLost, end, hand_back, sweep

LONG_S = 60.0
SHORT = SETTINGS.model_copy(update={"lease_s": 0.003, "lease_renewal_s": 0.001})
RUNS = Work.state == WorkState.RUNNING
FILES = {"scene_sha256": "1" * 64, "still_sha256": "2" * 64}


@pytest.fixture
def lease(team_a: Played) -> PlaybackLease:
    return claimed(team_a.database, team_a.ask(1).id)


def claimed(database: Database, playback_id: int, lease_s: float = LONG_S) -> PlaybackLease:
    with database.transaction() as session:
        return work.begin(session, take(session, playback_id, lease_s=lease_s))


def row(team_a: Played, number: int = 1) -> Playback:
    found = team_a.found(number)
    assert found is not None
    return found


def let_expire(team_a: Played) -> None:
    with team_a.database.transaction() as session:
        session.execute(update(Work).values(lease_expires_at=datetime.now(UTC) - timedelta(hours=1)).where(RUNS))


def recovered(team_a: Played) -> int:
    with team_a.database.transaction() as session:
        work.give_up_unmade(session)
        return sweep(session, SHORT, give_up=give_up).queued_again


def test_a_claim_gives_the_record(team_a: Played, lease: PlaybackLease) -> None:
    assert lease.record.episode == 1
    assert lease.record.record_digest() == team_a.episode().record_digest
    assert (lease.track, lease.attempt, lease.token) == ("track_1", 1, 1)


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
    assert made.state is WorkState.DONE
    assert (made.scene_sha256, made.cameras_sha256, made.still_sha256) == ("1" * 64, None, "2" * 64)
    assert made.env_steps_played == 3
    with team_a.database.transaction() as session:
        assert stored_digests(session) == set(FILES.values())
    with pytest.raises(LeaseLost), team_a.database.transaction() as session:
        end(session, lease, WorkState.FAILED, problem="too late")


def test_a_failed_one_says_why(team_a: Played, lease: PlaybackLease) -> None:
    with team_a.database.transaction() as session:
        end(session, lease, WorkState.FAILED, problem="The states differ.")
    assert row(team_a).state is WorkState.FAILED
    assert row(team_a).problem == "The states differ."


def test_who_lost_the_lease_changes_nothing(team_a: Played, lease: PlaybackLease) -> None:
    let_expire(team_a)
    assert recovered(team_a) == 1
    newer = claimed(team_a.database, lease.work_id)
    assert newer.token > lease.token
    changes: tuple[Callable[[Session], None], ...] = (
        lambda session: work.renew(session, lease, LONG_S, env_steps_played=1),
        lambda session: work.end_made(session, lease, FILES),
        lambda session: hand_back(session, lease),
    )
    for change in changes:
        with pytest.raises(LeaseLost), team_a.database.transaction() as session:
            change(session)
    assert row(team_a).state is WorkState.RUNNING


def test_a_lost_one_is_queued_again_and_given_up_at_last(team_a: Played, lease: PlaybackLease) -> None:
    for _ in range(SETTINGS.shard_attempts - 1):
        let_expire(team_a)
        assert recovered(team_a) == 1
        assert row(team_a).state is WorkState.QUEUED
        claimed(team_a.database, lease.work_id)
    let_expire(team_a)
    recovered(team_a)
    assert row(team_a).state is WorkState.FAILED
    assert "Started 3 times" in (row(team_a).problem or "")


def test_one_with_a_good_lease_is_left_alone(team_a: Played, lease: PlaybackLease) -> None:
    assert recovered(team_a) == 0
    assert row(team_a).token == lease.token


@pytest.mark.parametrize(
    ("asked", "heartbeat", "worker", "state"),
    [
        (61, None, {}, WorkState.FAILED),
        (59, None, {}, WorkState.QUEUED),
        (999, 0, {}, WorkState.QUEUED),
        (999, 59, {"state": WorkerState.STOPPED}, WorkState.QUEUED),
        (999, 61, {}, WorkState.FAILED),
        (61, 0, {"state": WorkerState.REFUSING}, WorkState.FAILED),
        (61, 0, {"evaluator_version": "0+other"}, WorkState.FAILED),
    ],
)
def test_one_is_given_up_when_for_an_hour_there_was_no_worker_that_can_make_it(
    team_a: Played, asked: int, heartbeat: int | None, worker: dict[str, Any], state: WorkState
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
    gave_up = state is WorkState.FAILED
    assert (found.finished_at is not None, found.problem is not None) == (gave_up, gave_up)


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
    assert row(team_a, 2).state is WorkState.QUEUED
