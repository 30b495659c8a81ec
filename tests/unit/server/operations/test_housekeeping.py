import hashlib
import os
import socket
import threading
import time
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import pytest
from asked_playbacks import played
from database_work import is_waiting_for_a_lock
from service_factories import claim, make_principal, make_settings, make_upload, shard_ids, state_of, take
from sqlalchemy import text
from vitac.server.database.engine import Database
from vitac.server.database.locks import AdvisoryLock, wait_for_turn
from vitac.server.database.metrics import SeriesKey, totals
from vitac.server.database.states import WorkState
from vitac.server.errors import ServiceError
from vitac.server.operations import housekeeping
from vitac.server.operations.housekeeping import Housekeeping, prune
from vitac.server.playbacks import work
from vitac.server.queue.workers import declare, declared_versions, versions_here
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore
from vitac.server.storage.scratch import scratch_folder
from vitac.server.submissions import creation
from worker_fakes import eventually


@pytest.fixture
def services(database: Database, tmp_path: Path) -> Services:
    settings = make_settings(state_dir=tmp_path, lease_s=0.4, lease_renewal_s=0.1, sweep_interval_s=0.05)
    settings.scratch_dir.mkdir()
    return Services(settings=settings, database=database, blobs=BlobStore.from_settings(settings), postgres=None)


def put(services: Services, content: bytes) -> str:
    path = services.settings.state_dir / "source"
    path.write_bytes(content)
    digest = hashlib.sha256(content).hexdigest()
    services.blobs.put(path, digest)
    return digest


def test_lost_shards_are_found_in_the_background_also_after_the_database_was_away(services: Services) -> None:
    with services.database.transaction() as session:
        submission = creation.create(session, make_principal(session), make_upload())[0]
        first = shard_ids(session, submission)[0]
    claim(services.database, first, lease_s=0.1)
    keeper = Housekeeping(services)
    keeper.start()
    with services.database.transaction() as session:
        session.execute(
            text(
                "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
                "WHERE datname = current_database() AND pid <> pg_backend_pid()"
            )
        )

    def is_queued_again() -> bool:
        with services.database.transaction() as session:
            return bool(state_of(session, first) is WorkState.QUEUED)

    eventually(is_queued_again)
    keeper.stop()


def test_one_of_several_server_processes_writes_what_it_counts_and_leaves_the_sweep_to_its_starter(
    services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    swept: list[bool] = []
    monkeypatch.setattr(Housekeeping, "_sweep", lambda _: swept.append(True))
    monkeypatch.setattr(housekeeping, "prune", lambda _: swept.append(True))
    for sweeps in (False, True):
        services.instruments.leases_lost.inc()
        before = leases_lost(services)
        keeper = Housekeeping(services, sweeps=sweeps)
        keeper.start()
        eventually(lambda before=before: leases_lost(services) > before)  # type: ignore[misc]
        keeper.stop()
        assert bool(swept) is sweeps


def test_work_that_fails_stops_none_of_the_other_work(services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
    """One old row that cannot be read ended the thread, and with it the sweep."""
    tried: list[str] = []

    def failing(name: str) -> Callable[..., None]:
        def fail(*_: object) -> None:
            tried.append(name)
            raise KeyError(name)

        return fail

    monkeypatch.setattr(Housekeeping, "_sweep", failing("_sweep"))
    monkeypatch.setattr(housekeeping, "prune", failing("prune"))
    keeper = Housekeeping(services)
    keeper.start()
    eventually(lambda: tried.count("_sweep") > 2)
    keeper.stop()
    assert tried[:2] == ["_sweep", "prune"]


def test_only_lost_shards_are_looked_for_in_every_round(services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    monkeypatch.setattr(housekeeping, "prune", lambda _: None)
    monkeypatch.setattr(Housekeeping, "_sweep", lambda _: done.append("shards"))
    monkeypatch.setattr(housekeeping, "supersede_outdated", lambda *_: done.append("versions"))
    monkeypatch.setattr(work, "give_up_unmade", lambda *_: done.append("playbacks"))
    keeper = Housekeeping(services)
    keeper.start()
    eventually(lambda: done.count("shards") > 3)
    assert done[:3] == ["shards", "versions", "playbacks"]
    assert set(done[3:]) == {"shards"}
    before = len(done)
    monkeypatch.setattr(housekeeping, "OTHERS_EVERY_S", 0.0)
    eventually(lambda: done.count("playbacks") > 2)
    keeper.stop()
    assert [what for what in done[before:] if what != "shards"][:4] == 2 * ["versions", "playbacks"]


def test_the_server_that_started_last_declares_its_evaluator_and_a_worker_never_does(
    services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    def declared() -> dict[str, str]:
        with services.database.transaction() as session:
            return declared_versions(session)

    monkeypatch.setattr(housekeeping, "OTHERS_EVERY_S", 0.0)
    rounds: list[None] = []
    monkeypatch.setattr(work, "give_up_unmade", lambda *_: rounds.append(None))
    worker = Housekeeping(services, supersedes=False)
    worker.start()
    eventually(lambda: len(rounds) > 2)
    assert declared() == {}
    worker.stop()
    old = Housekeeping(services)
    old.start()
    eventually(lambda: declared() == versions_here())
    with services.database.transaction() as session:
        declare(session, {"": "1+new"})
    seen = len(rounds)
    eventually(lambda: len(rounds) > seen + 3)
    assert declared() == {"": "1+new"}
    old.stop()


def leases_lost(services: Services) -> float:
    with services.database.transaction() as session:
        return totals(session).get(SeriesKey("vitac_leases_lost_total"), 0.0)


def test_files_without_a_submission_are_removed_once_the_store_works_again(
    services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(housekeeping, "ORPHAN_KEPT", timedelta(0))
    orphan = put(services, b"orphan")
    folder, aside = services.settings.state_dir / "blobs", services.settings.state_dir / "aside"
    folder.rename(aside)
    folder.write_text("not a folder")
    with pytest.raises(ServiceError, match="The file store does not work"):
        prune(services)
    keeper = Housekeeping(services)
    keeper.start()
    folder.unlink()
    aside.rename(folder)
    eventually(lambda: not services.blobs.holds(orphan))
    keeper.stop()


def test_files_without_a_submission_are_removed_when_old(services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
    kept, orphan = put(services, b"kept"), put(services, b"orphan")
    with services.database.transaction() as session:
        creation.create(session, make_principal(session), make_upload(archive_sha256=kept))
    prune(services)
    assert services.blobs.holds(orphan)
    monkeypatch.setattr(housekeeping, "ORPHAN_KEPT", timedelta(seconds=-5))
    prune(services)
    assert services.blobs.holds(kept)
    assert not services.blobs.holds(orphan)


def test_files_of_playbacks_stay_as_long_as_the_playbacks(services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(housekeeping, "ORPHAN_KEPT", timedelta(seconds=-5))
    scene, still = put(services, b"scene"), put(services, b"still")
    team = played(services.database)
    playback = team.ask(1)
    with services.database.transaction() as session:
        lease = work.begin(session, take(session, playback.id))
        work.end_made(session, lease, {"scene_sha256": scene, "still_sha256": still})
    prune(services)
    assert services.blobs.holds(scene)
    assert services.blobs.holds(still)
    with services.database.transaction() as session:
        session.execute(text("UPDATE playbacks SET asked_at = now() - interval '31 days'"))
    prune(services)
    assert team.found(1) is None
    assert not services.blobs.holds(scene)
    assert not services.blobs.holds(still)


def test_file_that_is_uploaded_again_while_old_ones_are_removed_stays(
    services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was old and without a row when housekeeping listed it; the team uploads the same content just then."""
    monkeypatch.setattr(housekeeping, "ORPHAN_KEPT", timedelta(hours=13))
    orphan = put(services, b"uploaded again")
    stored = next(services.settings.state_dir.glob(f"blobs/sha256/*/{orphan}"))
    long_ago = time.time() - timedelta(hours=14).total_seconds()
    os.utime(stored, (long_ago, long_ago))
    listed = services.blobs.list_older_than

    def list_then_upload(age: timedelta) -> list[str]:
        found = listed(age)
        put(services, b"uploaded again")
        return found

    monkeypatch.setattr(services.blobs, "list_older_than", list_then_upload)
    prune(services)
    assert services.blobs.holds(orphan)
    os.utime(stored, (long_ago, long_ago))
    monkeypatch.undo()
    prune(services)
    assert services.blobs.holds(orphan)  # for a day
    monkeypatch.setattr(housekeeping, "ORPHAN_KEPT", timedelta(hours=13))
    prune(services)
    assert not services.blobs.holds(orphan)


def test_file_is_not_removed_while_somebody_stores_it(services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(housekeeping, "ORPHAN_KEPT", timedelta(0))
    orphan = put(services, b"being stored")
    pruning = threading.Thread(target=prune, args=(services,))
    with services.database.transaction() as session:
        wait_for_turn(session, AdvisoryLock.STORED_FILE, orphan)
        pruning.start()
        eventually(lambda: is_waiting_for_a_lock(services.database))
        assert services.blobs.holds(orphan)
    pruning.join()
    assert not services.blobs.holds(orphan)


def test_folders_of_a_process_that_was_killed_are_removed_soon(services: Services) -> None:
    scratch = services.settings.scratch_dir
    left = [scratch / f"{purpose}-{socket.gethostname()}-x" for purpose in ("upload", "playback", "worker")]
    for folder in left:
        folder.mkdir()
    running = Housekeeping(services)
    with scratch_folder(scratch, "upload") as mine:
        running.start()
        eventually(lambda: list(scratch.iterdir()) == [mine])
        running.stop()


def test_leftovers_of_interrupted_uploads_and_playbacks_are_removed_when_old(services: Services) -> None:
    new, old, playback = (services.settings.scratch_dir / name for name in ("upload-new", "upload-old", "playback-old"))
    for folder in (new, old, playback):
        folder.mkdir()
        (folder / "archive.zip").write_bytes(b"half")
    long_ago = time.time() - 2 * housekeeping.ORPHAN_KEPT.total_seconds()
    for folder in (old, playback):
        os.utime(folder, (long_ago, long_ago))
    prune(services)
    assert new.is_dir()
    assert not old.exists()
    assert not playback.exists()
