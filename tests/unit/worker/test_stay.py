"""Workers that a scheduler lends a machine for a while end by themselves, and lose nothing."""

import time

import pytest
from service_factories import make_principal, make_upload
from sqlalchemy import func, select
from vitac.server.database.models import Shard, Submission, Worker
from vitac.server.database.states import EvaluationState, WorkerState, WorkState
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.services import Services
from vitac.server.submissions import creation
from vitac.worker import main
from vitac.worker.capabilities import IsolationReport
from vitac.worker.main import Stay, WorkerRefused
from worker_fakes import FakeShards

SOUND = IsolationReport(level="user: root", problems=())
LEAKY = IsolationReport(level="user: root", problems=("network refused: escaped (reached 1).",))


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
