import errno
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from asked_playbacks import Played, played
from service_factories import take
from shown_sensors import a_made_sensor
from sqlalchemy import text
from vitac.evaluator.playback import CAMERAS_FILE, SCENE_FILE, MakingBroke, PlaybackFailed, PlaybackOrder
from vitac.server.database.models import Playback
from vitac.server.database.states import WorkState
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.playbacks import work as playbacks
from vitac.server.playbacks.work import PlaybackLease
from vitac.server.queue.work import RETRY_DELAY_S
from vitac.server.services import Services
from vitac.worker import leased_run
from vitac.worker.leased_run import RunEnd
from vitac.worker.short_runs import PlaybackRun
from worker_fakes import eventually


class FakeMaking:
    """Counts env steps and writes a file of each kind but the still; `during` is called after the first env step."""

    def __init__(self, during: Callable[[], None] = lambda: None) -> None:
        self.killed = threading.Event()
        self.folders: list[Path] = []
        self._during = during

    @contextmanager
    def __call__(self, order: PlaybackOrder) -> Iterator["FakeMaking"]:
        self.order = order
        self.folders.append(order.folder)
        yield self

    def played(self) -> Iterator[int]:
        yield 1
        self._during()
        if self.killed.is_set():
            raise MakingBroke("The process was killed.")
        (self.order.folder / SCENE_FILE).write_bytes(b"scene")
        (self.order.folder / CAMERAS_FILE).write_bytes(b"cameras")
        yield self.order.record.env_steps

    def kill(self) -> None:
        self.killed.set()


@pytest.fixture
def team(services: Services) -> Played:
    return played(services.database)


@pytest.fixture
def lease(services: Services, team: Played) -> PlaybackLease:
    playback = team.ask(1)
    with services.database.transaction() as session:
        return playbacks.begin(session, take(session, playback.id))


def row(team: Played) -> Playback:
    found = team.found(1)
    assert found is not None
    return found


def delay_s(services: Services) -> float:
    """How long the newest work waits."""
    newest = text("SELECT extract(epoch FROM not_before - now()) FROM work ORDER BY id DESC LIMIT 1")
    with services.database.transaction() as session:
        return float(session.scalar(newest) or 0.0)


def raising(error: Exception) -> Callable[[], None]:
    def fail() -> None:
        raise error

    return fail


def test_the_files_are_stored_and_the_folder_is_removed(services: Services, team: Played, lease: PlaybackLease) -> None:
    making = FakeMaking()
    assert PlaybackRun(services, lease, making).run() is RunEnd.FINISHED
    made = row(team)
    assert made.state is WorkState.DONE
    assert services.blobs.read(made.scene_sha256 or "") == b"scene"
    assert services.blobs.read(made.cameras_sha256 or "") == b"cameras"
    assert made.still_sha256 is None
    assert not making.folders[0].exists()


def test_progress_is_stored_while_it_runs_and_the_lease_kept(
    services: Services, team: Played, lease: PlaybackLease
) -> None:
    before = row(team).lease_expires_at
    assert before is not None

    def renewed() -> bool:
        now = row(team)
        return now.env_steps_played == 1 and now.lease_expires_at not in {None, before}

    assert PlaybackRun(services, lease, FakeMaking(lambda: eventually(renewed))).run() is RunEnd.FINISHED


def test_what_cannot_be_shown_fails_with_its_reason(services: Services, team: Played, lease: PlaybackLease) -> None:
    refused = FakeMaking(raising(PlaybackFailed("The states differ.")))
    assert PlaybackRun(services, lease, refused).run() is RunEnd.FINISHED
    assert row(team).state is WorkState.FAILED
    assert row(team).problem == "The states differ."


def test_what_broke_is_tried_again_and_fails_at_last(services: Services, team: Played, lease: PlaybackLease) -> None:
    broken = FakeMaking(raising(MakingBroke("exit code -9")))
    for attempt in range(1, services.settings.shard_attempts + 1):
        assert lease.attempt == attempt
        assert PlaybackRun(services, lease, broken).run() is RunEnd.BROKE
        if attempt < services.settings.shard_attempts:
            assert row(team).state is WorkState.QUEUED
            assert delay_s(services) == pytest.approx(attempt * RETRY_DELAY_S, abs=1.0)
            with services.database.transaction() as session:
                lease = playbacks.begin(session, take(session, lease.work_id))
    assert row(team).state is WorkState.FAILED
    assert row(team).problem == "Tried 3 times without progress. The last time: exit code -9"


def test_a_storage_that_is_away_is_waited_for_before_and_after(
    services: Services, team: Played, lease: PlaybackLease, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leased_run, "STORAGE_PAUSE_S", 0.01)
    away = ServiceError(ProblemCode.STORAGE_UNAVAILABLE, "The file store does not work.")
    refusals, read, put = [away] * 6, services.blobs.read, services.blobs.put
    sensor = a_made_sensor()
    file = services.settings.scratch_dir / "sensor"
    file.write_bytes(sensor.as_bytes())
    put(file, sensor.digest)

    def refuse(*, left: int) -> None:
        if len(refusals) > left:
            raise refusals.pop()

    def read_later(sha256: str) -> bytes:
        refuse(left=3)
        return read(sha256)

    def put_later(path: Path, sha256: str) -> None:
        refuse(left=0)
        put(path, sha256)

    monkeypatch.setattr(services.blobs, "read", read_later)
    monkeypatch.setattr(services.blobs, "put", put_later)
    making = FakeMaking()
    assert PlaybackRun(services, replace(lease, sensor_sha256=sensor.digest), making).run() is RunEnd.FINISHED
    assert (refusals, making.order.sensor) == ([], sensor)
    assert (row(team).state, row(team).attempts) == (WorkState.DONE, 1)


def test_a_full_disk_is_no_attempt(services: Services, team: Played, lease: PlaybackLease) -> None:
    full = FakeMaking(raising(OSError(errno.ENOSPC, "No space left on device")))
    assert PlaybackRun(services, lease, full).run() is RunEnd.HANDED_BACK
    assert row(team).state is WorkState.QUEUED
    assert row(team).attempts == 0


def test_a_worker_that_stops_gives_it_back(services: Services, team: Played, lease: PlaybackLease) -> None:
    making = FakeMaking(lambda: run.stop())
    run = PlaybackRun(services, lease, making)
    assert run.run() is RunEnd.HANDED_BACK
    assert making.killed.is_set()
    assert row(team).state is WorkState.QUEUED
    assert row(team).attempts == 0


def test_a_worker_that_stopped_before_starts_nothing(services: Services, team: Played, lease: PlaybackLease) -> None:
    run = PlaybackRun(services, lease, FakeMaking())
    run.stop()
    assert run.run() is RunEnd.HANDED_BACK


def test_who_lost_the_lease_ends_the_process(services: Services, team: Played, lease: PlaybackLease) -> None:
    def lose() -> None:
        with services.database.transaction() as session:
            session.get_one(Playback, lease.work_id).token += 1
        eventually(making.killed.is_set)

    making = FakeMaking(lose)
    assert PlaybackRun(services, lease, making).run() is RunEnd.LOST
    assert row(team).scene_sha256 is None


def test_a_process_that_hangs_is_ended(services: Services, team: Played, lease: PlaybackLease) -> None:
    making = FakeMaking(lambda: eventually(making.killed.is_set))
    impatient = services.settings.model_copy(update={"shard_idle_timeout_s": 0.2})
    hanging = Services(settings=impatient, database=services.database, blobs=services.blobs, postgres=None)
    assert PlaybackRun(hanging, lease, making).run() is RunEnd.BROKE
