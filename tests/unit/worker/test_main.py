import errno
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from service_factories import make_principal, make_upload
from sqlalchemy import func, select, text
from vitac.evaluator.agent.isolation.packages import PolicyPackages
from vitac.evaluator.package_sets import PackageSet, locked_versions
from vitac.evaluator.version import evaluator_version
from vitac.server.database.models import Shard, Submission, Worker
from vitac.server.database.states import EvaluationState, WorkerState, WorkState
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.operations import housekeeping
from vitac.server.playbacks import work
from vitac.server.queue.workers import OWN_SOURCES, declare, versions_here, workers_alive
from vitac.server.services import Services
from vitac.server.settings import OutdatedRule
from vitac.server.submissions import creation
from vitac.worker import capabilities, main
from vitac.worker.capabilities import IsolationReport
from vitac.worker.main import Stay, WorkerRefused
from vitac.worker.staging import SubmissionStage
from worker_fakes import FakeShards, eventually

SOUND = IsolationReport(level="user: root", problems=())
LEAKY = IsolationReport(level="user: root", problems=("network refused: escaped (reached 1).",))


@contextmanager
def signalled_when(holds: Callable[[], bool], number: int = signal.SIGTERM) -> Iterator[None]:
    """Sends this process a signal as soon as something holds; work() runs in the main thread meanwhile."""

    def wait() -> None:
        try:
            eventually(holds)
        finally:
            os.kill(os.getpid(), number)

    thread = threading.Thread(target=wait)
    thread.start()
    yield
    thread.join()


def rows(services: Services) -> list[Worker]:
    with services.database.transaction() as session:
        return list(session.scalars(select(Worker)))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_worker_registers_evaluates_and_reports_its_end_on_a_signal(
    services: Services, archive_sha256: str, number: int
) -> None:
    with services.database.transaction() as session:
        principal = make_principal(session)
        submission = creation.create(session, principal, make_upload(archive_sha256=archive_sha256))[0]

    def is_completed() -> bool:
        with services.database.transaction() as session:
            return newest_evaluation(session, submission).state is EvaluationState.COMPLETED

    before = signal.getsignal(number)
    with signalled_when(is_completed, number):
        main.work(services, FakeShards(), probe=lambda: SOUND)
    assert signal.getsignal(number) is before
    worker = rows(services)[0]
    assert (worker.state, worker.isolation, worker.pid) == (WorkerState.STOPPED, "user: root", os.getpid())
    assert worker.evaluator_version == evaluator_version()
    assert list(services.settings.scratch_dir.glob("worker-*")) == []


def test_living_worker_is_counted_and_its_heartbeat_goes_on(services: Services) -> None:
    seen = []

    def beats() -> bool:
        with services.database.transaction() as session:
            alive = workers_alive(session, services.settings)
        if alive.alive == 1 and alive.last_heartbeat_at not in seen:
            seen.append(alive.last_heartbeat_at)
        return len(seen) == 3

    with signalled_when(beats):
        main.work(services, FakeShards(), probe=lambda: SOUND)
    assert len(seen) == 3


def test_worker_leaves_it_to_the_server_to_begin_evaluations_again(
    services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    monkeypatch.setattr(housekeeping, "OTHERS_EVERY_S", 0.0)
    monkeypatch.setattr(housekeeping, "supersede_outdated", lambda *_: done.append("evaluations"))
    monkeypatch.setattr(work, "give_up_unmade", lambda *_: done.append("playbacks"))
    with signalled_when(lambda: done.count("playbacks") > 1):
        main.work(services, FakeShards(), probe=lambda: SOUND)
    assert set(done) == {"playbacks"}


def test_worker_beside_a_database_that_another_release_upgrades_gives_its_shard_back_and_ends(
    services: Services, archive_sha256: str
) -> None:
    with services.database.transaction() as session:
        submission = creation.create(session, make_principal(session), make_upload(archive_sha256=archive_sha256))[0]

    def upgrade_meanwhile(_: int) -> None:
        with services.database.transaction() as session:
            session.execute(text("UPDATE alembic_version SET version_num = 'later'"))
            session.execute(text("UPDATE schema_compatibility SET oldest = 'later'"))
        shards.started[0].killed.wait()

    shards = FakeShards(gate=upgrade_meanwhile)
    main.work(services, shards, probe=lambda: SOUND)
    assert rows(services)[0].state is WorkerState.STOPPED
    with services.database.transaction() as session:
        evaluation = newest_evaluation(session, submission)
        assert evaluation.state is EvaluationState.RUNNING
        assert WorkState.RUNNING not in {shard.state for shard in evaluation.shards}
        assert [shard.attempts for shard in evaluation.shards] == [0] * len(evaluation.shards)


def test_worker_on_a_machine_that_leaks_takes_nothing_and_says_why(services: Services, archive_sha256: str) -> None:
    with services.database.transaction() as session:
        creation.create(session, make_principal(session), make_upload(archive_sha256=archive_sha256))
    shards = FakeShards()

    def refuses() -> bool:
        return any(row.state is WorkerState.REFUSING for row in rows(services))

    with signalled_when(refuses):
        main.work(services, shards, probe=lambda: LEAKY)
    assert shards.started == []
    assert "network refused: escaped" in rows(services)[0].message
    with services.database.transaction() as session:
        assert workers_alive(session, services.settings).alive == 0


def test_worker_of_another_evaluator_takes_nothing_and_says_what_to_do(services: Services, archive_sha256: str) -> None:
    with services.database.transaction() as session:
        creation.create(session, make_principal(session), make_upload(archive_sha256=archive_sha256))
        declare(session, versions_here() | {OWN_SOURCES: "1+another"})
    shards = FakeShards()
    with signalled_when(lambda: any(row.state is WorkerState.REFUSING for row in rows(services))):
        main.work(services, shards, probe=lambda: SOUND)
    assert shards.started == []
    assert rows(services)[0].message == (
        f"This worker has evaluator {evaluator_version()}, the service 1+another: it takes no shards. Install the "
        "release of the service on this machine and start the worker again."
    )


def test_worker_leaves_its_shard_when_the_service_declares_another_evaluator(
    services: Services, archive_sha256: str
) -> None:
    with services.database.transaction() as session:
        submission = creation.create(session, make_principal(session), make_upload(archive_sha256=archive_sha256))[0]
        declare(session, versions_here())

    def upgrade_meanwhile(_: int) -> None:
        with services.database.transaction() as session:
            declare(session, versions_here() | {OWN_SOURCES: "1+another"})
        shards.started[0].killed.wait()

    shards = FakeShards(gate=upgrade_meanwhile)
    with signalled_when(lambda: any(row.state is WorkerState.REFUSING for row in rows(services))):
        main.work(services, shards, probe=lambda: SOUND)
    assert len(shards.started) == 1
    with services.database.transaction() as session:
        states = {shard.state for shard in newest_evaluation(session, submission).shards}
        assert workers_alive(session, services.settings).alive == 0
    assert states == {WorkState.QUEUED}


@pytest.mark.slow
def test_worker_finishes_what_began_with_its_evaluator_where_the_service_says_so_and_takes_nothing_afterwards(
    services: Services, archive_sha256: str
) -> None:
    with services.database.transaction() as session:
        principal = make_principal(session)
        submission = creation.create(session, principal, make_upload(archive_sha256=archive_sha256))[0]
        declare(session, versions_here())

    def upgrade_meanwhile(_: int) -> None:
        with services.database.transaction() as session:
            declare(session, versions_here() | {OWN_SOURCES: "1+another"}, OutdatedRule.FINISH)

    shards = FakeShards(gate=upgrade_meanwhile)
    with signalled_when(lambda: any(row.state is WorkerState.REFUSING for row in rows(services))):
        main.work(services, shards, probe=lambda: SOUND)
    with services.database.transaction() as session:
        evaluation = newest_evaluation(session, submission)
        assert (evaluation.state, evaluation.evaluator_version) == (EvaluationState.COMPLETED, evaluator_version())
        assert len(shards.started) == len(evaluation.shards)


def test_worker_whose_policies_would_see_other_packages_takes_no_shards_of_that_track_and_says_which(
    services: Services, archive_sha256: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with services.database.transaction() as session:
        creation.create(session, make_principal(session), make_upload(archive_sha256=archive_sha256))
    found = PolicyPackages(versions={**dict.fromkeys(locked_versions([PackageSet.BASE]), "0")}, binds=())
    monkeypatch.setattr(capabilities, "installed_packages", lambda _: found)
    shards = FakeShards()
    with signalled_when(lambda: any(row.state is WorkerState.READY for row in rows(services))):
        main.work(services, shards, probe=lambda: SOUND)
    (worker,) = rows(services)
    assert shards.started == []
    assert worker.families == []
    assert "track_1: its policies would see other packages than it declares: annotated-doc is 0" in worker.message


def test_worker_without_disk_space_at_its_start_waits_for_it(
    services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    refusals = iter([OSError(errno.ENOSPC, "No space left on device")])

    def stage(*arguments: Any) -> SubmissionStage:
        for error in refusals:
            raise error
        return SubmissionStage(*arguments)

    monkeypatch.setattr(main, "SubmissionStage", stage)
    monkeypatch.setattr(main, "DISK_AGAIN_S", 0.05)
    with signalled_when(lambda: len(rows(services)) == 2):
        main.work(services, FakeShards(), probe=lambda: SOUND)
    assert {row.state for row in rows(services)} == {WorkerState.STOPPED}


def test_worker_goes_to_work_when_the_machine_was_mended(services: Services, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(main, "PROBE_AGAIN_S", 0.05)
    reports = iter([LEAKY, SOUND])

    def is_ready() -> bool:
        return any(row.state is WorkerState.READY for row in rows(services))

    with signalled_when(is_ready):
        main.work(services, FakeShards(), probe=lambda: next(reports))
    assert sorted(str(row.isolation) for row in rows(services)) == ["user: root"] * 2


# ---- Workers that a scheduler lends a machine for a while end by themselves, and lose nothing ----


@pytest.fixture
def submission(services: Services, archive_sha256: str) -> Submission:
    with services.database.transaction() as session:
        return creation.create(session, make_principal(session), make_upload(archive_sha256=archive_sha256))[0]


def count_shards(services: Services, state: WorkState) -> int:
    with services.database.transaction() as session:
        return session.scalar(select(func.count()).where(Shard.state == state)) or 0


def test_worker_that_takes_one_piece_of_work_finishes_it_and_ends(services: Services, submission: Submission) -> None:
    queued = count_shards(services, WorkState.QUEUED)
    assert queued > 1
    main.work(services, FakeShards(), Stay(runs=1), probe=lambda: SOUND)
    assert count_shards(services, WorkState.DONE) == 1
    assert count_shards(services, WorkState.QUEUED) == queued - 1
    with services.database.transaction() as session:
        assert session.scalars(select(Worker.state)).all() == [WorkerState.STOPPED]


def test_worker_ends_when_it_has_been_idle_and_not_before_the_queue_is_empty(
    services: Services, submission: Submission
) -> None:
    main.work(services, FakeShards(), Stay(idle_s=0.2), probe=lambda: SOUND)
    with services.database.transaction() as session:
        assert newest_evaluation(session, submission).state is EvaluationState.COMPLETED


def test_worker_past_its_lifetime_takes_nothing(services: Services, submission: Submission) -> None:
    began_long_ago = Stay(lifetime_s=3600.0, began=time.monotonic() - 3601.0)
    main.work(services, FakeShards(), began_long_ago, probe=lambda: SOUND)
    assert count_shards(services, WorkState.DONE) == 0


def test_worker_with_a_limited_stay_does_not_wait_on_a_machine_that_may_not_run_policies(services: Services) -> None:
    with pytest.raises(WorkerRefused, match=r"This machine may not run policies.*vitac doctor"):
        main.work(services, FakeShards(), Stay(idle_s=60.0), probe=lambda: LEAKY)


@pytest.mark.parametrize(
    ("stay", "is_over"),
    [
        (Stay(), False),
        (Stay(runs=3), False),
        (Stay(runs=2), True),
        (Stay(idle_s=6.0), False),
        (Stay(idle_s=5.0), True),
        (Stay(lifetime_s=1e9), False),
        (Stay(lifetime_s=0.0), True),
    ],
)
def test_stay_is_over_at_any_of_its_limits(stay: Stay, *, is_over: bool) -> None:
    assert stay.is_over(taken=2, idle_s=5.0) is is_over
