import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from uuid import uuid4

import pytest
from asked_playbacks import played
from service_factories import make_principal, make_record, make_upload, shard_ids, take_shard
from sqlalchemy import select, text
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.playback import SCENE_FILE, PlaybackOrder
from vitac.evaluator.shards.order import ShardOrder, ShardResult
from vitac.server.database.metrics import SeriesKey, totals
from vitac.server.database.models import EpisodeResult, Playback, Shard, Submission
from vitac.server.database.states import EvaluationState, WorkerOrder, WorkState
from vitac.server.evaluations.episode_store import store_episodes
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.lifecycle import EpisodesMissing, finish_shard
from vitac.server.operations.housekeeping import Housekeeping
from vitac.server.principals import CONSOLE
from vitac.server.queue import work
from vitac.server.queue.leases import Lease
from vitac.server.services import Services
from vitac.server.submissions import creation, runs
from vitac.worker import shard_run
from vitac.worker.staging import SubmissionStage
from vitac.worker.worker import QueueWorker
from worker_fakes import FakeShard, FakeShards, eventually


def submit(services: Services, archive_sha256: str, team: str = "Team A", **changes: Any) -> Submission:
    with services.database.transaction() as session:
        upload = make_upload(archive_sha256=archive_sha256, **changes)
        return creation.create(session, make_principal(session, team), upload)[0]


def state(services: Services, submission: Submission) -> EvaluationState:
    # Repeated, because some tests cut all connections, also this one.
    return services.database.retrying(
        lambda session: newest_evaluation(session, submission).state, give_up_after_s=20.0
    )


def result_hash(services: Services, submission: Submission) -> str | None:
    with services.database.transaction() as session:
        return newest_evaluation(session, submission).result_hash


@contextmanager
def working(services: Services, shards: FakeShards, **options: Any) -> Iterator[QueueWorker]:
    """A worker in a thread, with housekeeping beside it, stopped at the end."""
    stage = SubmissionStage(services.blobs, services.settings.scratch_dir, services.settings.limits)
    worker = QueueWorker(services, stage, uuid4(), shards, **options)
    thread = threading.Thread(target=worker.run)
    housekeeping = Housekeeping(services)
    housekeeping.start()
    thread.start()
    try:
        yield worker
    finally:
        worker.stop()
        thread.join(120.0)
        housekeeping.stop()
        stage.close()
        assert not thread.is_alive()


def drop_connections(services: Services) -> None:
    with services.database.transaction() as session:
        session.execute(
            text(
                "SELECT pg_terminate_backend(pid) FROM pg_stat_activity "
                "WHERE datname = current_database() AND pid <> pg_backend_pid()"
            )
        )


def test_worker_evaluates_what_is_in_the_queue_and_what_comes_later(services: Services, archive_sha256: str) -> None:
    first = submit(services, archive_sha256)
    with working(services, FakeShards()):
        eventually(lambda: state(services, first) is EvaluationState.COMPLETED)
        second = submit(services, archive_sha256, "Team B", digest="b" * 64)
        eventually(lambda: state(services, second) is EvaluationState.COMPLETED)
    assert result_hash(services, first) == result_hash(services, second)
    with services.database.transaction() as session:
        assert work.count_open(session) == 0


@pytest.mark.slow
def test_two_workers_share_the_shards_and_give_the_same_hash(services: Services, archive_sha256: str) -> None:
    alone = submit(services, archive_sha256)
    with working(services, FakeShards()):
        eventually(lambda: state(services, alone) is EvaluationState.COMPLETED)
    both_at_work = threading.Barrier(2)
    shared = submit(services, archive_sha256, "Team B", digest="b" * 64)

    def gate(number: int) -> None:
        if number in (1, 31):
            both_at_work.wait(120.0)

    with working(services, FakeShards(gate=gate)), working(services, FakeShards(gate=gate)):
        eventually(lambda: state(services, shared) is EvaluationState.COMPLETED)
    assert result_hash(services, shared) == result_hash(services, alone)
    with services.database.transaction() as session:
        workers = session.scalars(select(Shard.worker_id).where(Shard.id.in_(shard_ids(session, shared))))
        assert len(set(workers)) == 2


def test_worker_survives_the_loss_of_all_connections(services: Services, archive_sha256: str) -> None:
    submission = submit(services, archive_sha256)
    dropped = threading.Event()

    def gate(number: int) -> None:
        if number == 40 and not dropped.is_set():
            dropped.set()
            drop_connections(services)

    with working(services, FakeShards(gate=gate)):
        eventually(lambda: state(services, submission) is EvaluationState.COMPLETED)
    assert dropped.is_set()
    with services.database.transaction() as session:
        assert len(session.scalars(select(EpisodeResult.id)).all()) == 270


@pytest.mark.parametrize("order", [WorkerOrder.CORDON, WorkerOrder.DRAIN])
def test_a_worker_that_takes_no_more_finishes_its_shard_and_then_waits_or_ends(
    services: Services, archive_sha256: str, order: WorkerOrder
) -> None:
    submission = submit(services, archive_sha256)
    given, at_five = [WorkerOrder.WORK], threading.Event()

    def gate(number: int) -> None:
        if number == 5:
            given[0] = order
            at_five.set()

    def done() -> list[WorkState]:
        with services.database.transaction() as session:
            ids = shard_ids(session, submission)
            return list(session.scalars(select(Shard.state).where(Shard.id.in_(ids)).order_by(Shard.id)))

    shards = FakeShards(gate=gate)
    with working(services, shards, order=lambda: given[0]) as worker:
        assert at_five.wait(120.0)
        eventually(lambda: done()[0] is WorkState.DONE)
        if order is WorkerOrder.DRAIN:
            eventually(lambda: worker.idle_s > 0)
        else:
            given[0] = WorkerOrder.WORK
            eventually(lambda: state(services, submission) is EvaluationState.COMPLETED)
    assert len(shards.started) == (1 if order is WorkerOrder.DRAIN else 10)


def test_stopped_worker_gives_its_shard_back_and_another_one_goes_on(services: Services, archive_sha256: str) -> None:
    submission = submit(services, archive_sha256)
    at_five = threading.Event()
    shards = FakeShards()

    def gate(number: int) -> None:
        if number == 5:
            at_five.set()
            shards.started[-1].killed.wait(120.0)

    shards.gate = gate
    with working(services, shards):
        assert at_five.wait(120.0)
    with services.database.transaction() as session:
        first = session.get_one(Shard, shard_ids(session, submission)[0])
        assert (first.state, first.attempts) == (WorkState.QUEUED, 0)
    again = FakeShards()
    with working(services, again):
        eventually(lambda: state(services, submission) is EvaluationState.COMPLETED)
    assert again.started[0].order.skip == (1, 2, 3, 4)


def test_shard_of_a_lost_worker_goes_to_another_one_which_resumes_it(services: Services, archive_sha256: str) -> None:
    submission = submit(services, archive_sha256)
    with services.database.transaction() as session:
        lost = take_shard(session, shard_ids(session, submission)[0], lease_s=0.2)
        store_episodes(session, lost, [make_record(1)])
    shards = FakeShards()
    with working(services, shards):
        eventually(lambda: state(services, submission) is EvaluationState.COMPLETED)
    resumed: ShardOrder = next(shard.order for shard in shards.started if shard.order.shard == 0)
    assert resumed.skip == (1,)


def test_cancel_frees_the_worker_for_the_next_submission(services: Services, archive_sha256: str) -> None:
    hanging = submit(services, archive_sha256)
    shards = FakeShards()
    hung = threading.Event()

    def gate(number: int) -> None:
        if len(shards.started) == 1:
            hung.set()
            shards.started[0].killed.wait(120.0)

    shards.gate = gate
    with working(services, shards):
        assert hung.wait(120.0)
        with services.database.transaction() as session:
            runs.cancel(session, CONSOLE, hanging.id)
        assert shards.started[0].killed.wait(120.0)
        other = submit(services, archive_sha256, "Team B", digest="b" * 64)
        eventually(lambda: state(services, other) is EvaluationState.COMPLETED)


@pytest.mark.parametrize("slots", [3])
def test_slots_run_shards_at_the_same_time(services: Services, archive_sha256: str, slots: int) -> None:
    several = Services(
        settings=services.settings.model_copy(update={"worker_slots": slots}),
        database=services.database,
        blobs=services.blobs,
        postgres=None,
    )
    together = threading.Barrier(slots)

    def gate(number: int) -> None:
        if number in (1, 31, 61):
            together.wait(120.0)

    submission = submit(services, archive_sha256)
    with working(several, FakeShards(gate=gate)):
        eventually(lambda: state(services, submission) is EvaluationState.COMPLETED)


class CountingShards(FakeShards):
    """Counts the processes that run at the same time."""

    def __init__(self) -> None:
        super().__init__()
        self.most = 0
        self._running = 0
        self._lock = threading.Lock()

    @contextmanager
    def __call__(self, order: ShardOrder) -> Iterator[FakeShard]:
        with self._lock:
            self._running += 1
            self.most = max(self.most, self._running)
        try:
            with super().__call__(order) as shard:
                yield shard
        finally:
            with self._lock:
                self._running -= 1


def test_next_shard_begins_while_the_result_of_the_one_before_is_stored(
    services: Services, archive_sha256: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shards = CountingShards()
    n_shards = 10

    def finish(session: Session, lease: Lease, result: ShardResult) -> None:
        eventually(lambda: len(shards.started) >= min(lease.number + 2, n_shards))
        finish_shard(session, lease, result)

    monkeypatch.setattr(shard_run, "finish_shard", finish)
    submission = submit(services, archive_sha256)
    with working(services, shards):
        eventually(lambda: state(services, submission) is EvaluationState.COMPLETED)
    assert [shard.order.shard for shard in shards.started] == list(range(n_shards))
    assert shards.most == services.settings.worker_slots == 1


def test_worker_keeps_at_most_two_results_back_for_a_slot(
    services: Services, archive_sha256: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shards, may_be_stored = FakeShards(), threading.Event()

    def finish(session: Session, lease: Lease, result: ShardResult) -> None:
        assert may_be_stored.wait(120.0)
        finish_shard(session, lease, result)

    monkeypatch.setattr(shard_run, "finish_shard", finish)
    submission = submit(services, archive_sha256)
    with working(services, shards):
        eventually(lambda: len(shards.started) == 2)
        eventually(lambda: played_to_the_end(services, shards))
        with services.database.transaction() as session:
            states = [session.get_one(Shard, shard_id).state for shard_id in shard_ids(session, submission)]
        assert states.count(WorkState.RUNNING) == len(shards.started) == 2
        may_be_stored.set()
        eventually(lambda: state(services, submission) is EvaluationState.COMPLETED)


def played_to_the_end(services: Services, shards: FakeShards) -> bool:
    with services.database.transaction() as session:
        stored = set(session.scalars(select(EpisodeResult.episode)))
    return all(stored.issuperset(shard.order.episodes or ()) for shard in shards.started)


def test_stopped_worker_stores_what_is_played_and_gives_back_what_has_begun(
    services: Services, archive_sha256: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shards = FakeShards()
    second_began, stopping = threading.Event(), threading.Event()

    def gate(number: int) -> None:
        if len(shards.started) == 2:
            second_began.set()
            shards.started[1].killed.wait(120.0)
            stopping.set()

    def finish(session: Session, lease: Lease, result: ShardResult) -> None:
        assert stopping.wait(120.0)
        finish_shard(session, lease, result)

    shards.gate = gate
    monkeypatch.setattr(shard_run, "finish_shard", finish)
    submission = submit(services, archive_sha256)
    with working(services, shards):
        assert second_began.wait(120.0)
    with services.database.transaction() as session:
        found = [session.get_one(Shard, shard_id) for shard_id in shard_ids(session, submission)]
    assert [shard.state for shard in found[:2]] == [WorkState.DONE, WorkState.QUEUED]
    assert [shard.attempts for shard in found[:2]] == [0, 0]
    assert {shard.state for shard in found[2:]} == {WorkState.QUEUED}


@pytest.mark.slow
def test_shard_whose_result_cannot_be_stored_runs_again_after_the_one_that_has_begun(
    services: Services, archive_sha256: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    shards, refused = FakeShards(), threading.Event()

    def finish(session: Session, lease: Lease, result: ShardResult) -> None:
        if lease.number == 0 and not refused.is_set():
            eventually(lambda: len(shards.started) == 2)
            refused.set()
            raise EpisodesMissing("Some are not stored.")
        finish_shard(session, lease, result)

    monkeypatch.setattr(shard_run, "finish_shard", finish)
    monkeypatch.setattr(work, "RETRY_DELAY_S", 0.01)
    submission = submit(services, archive_sha256)
    with working(services, shards):
        eventually(lambda: state(services, submission) is EvaluationState.COMPLETED)
    assert refused.is_set()
    with services.database.transaction() as session:
        tokens = [session.get_one(Shard, shard_id).token for shard_id in shard_ids(session, submission)]
    assert tokens == [2] + [1] * 9


def test_worker_counts_claims_waits_and_episodes_in_the_totals_of_all(services: Services, archive_sha256: str) -> None:
    submission = submit(services, archive_sha256)
    with working(services, FakeShards()):
        eventually(lambda: state(services, submission) is EvaluationState.COMPLETED)
    with services.database.transaction() as session:
        n_shards, found = len(shard_ids(session, submission)), totals(session)
    assert found[SeriesKey("vitac_episodes_total", '{"task": "peg-insertion"}')] == 270
    assert found[SeriesKey("vitac_shards_finished_total")] == n_shards
    assert found[SeriesKey("vitac_shard_wait_seconds_count")] == n_shards
    assert found[SeriesKey("vitac_claim_seconds_count")] >= n_shards


@pytest.mark.slow
def test_a_playback_is_made_before_the_evaluations_that_wait(services: Services, archive_sha256: str) -> None:
    team = played(services.database)
    playback = team.ask(1)
    order: list[str] = []

    @contextmanager
    def making(asked: PlaybackOrder) -> Iterator[FakePlayback]:
        order.append("playback")
        yield FakePlayback(asked)

    def record_of(number: int, *arguments: Any, **values: Any) -> EpisodeRecord:
        order.append("shard")
        return make_record(number, *arguments, **values)

    with services.database.transaction() as session:
        session.get_one(Submission, team.submission.id).archive_sha256 = archive_sha256
    with working(services, FakeShards(record_of), start_playback=making):
        eventually(lambda: state(services, team.submission) is EvaluationState.COMPLETED)
    assert state_of_playback(services, playback.id) is WorkState.DONE
    assert order[0] == "playback"


def state_of_playback(services: Services, playback_id: int) -> WorkState:
    with services.database.transaction() as session:
        return session.get_one(Playback, playback_id).state


class FakePlayback:
    """Writes a scene."""

    def __init__(self, order: PlaybackOrder) -> None:
        self._order = order

    def played(self) -> Iterator[int]:
        (self._order.folder / SCENE_FILE).write_bytes(b"scene")
        yield self._order.record.env_steps

    def kill(self) -> None:
        """It ends by itself."""


@pytest.mark.slow
def test_stills_of_a_new_public_result_are_asked_for_with_its_last_shard(
    services: Services, archive_sha256: str
) -> None:
    shown, hidden = (submit(services, archive_sha256, team, digest=team[-1] * 64) for team in ("Team a", "Team b"))
    with services.database.transaction() as session:
        session.get_one(Submission, shown.id).is_public = True

    @contextmanager
    def making(asked: PlaybackOrder) -> Iterator[FakePlayback]:
        yield FakePlayback(asked)

    with working(services, FakeShards(), start_playback=making):
        eventually(lambda: state(services, hidden) is EvaluationState.COMPLETED)
        eventually(lambda: state(services, shown) is EvaluationState.COMPLETED)
    with services.database.transaction() as session:
        asked = session.scalars(
            select(EpisodeResult.submission_digest).join(Playback, Playback.episode_id == EpisodeResult.id)
        )
        assert set(asked) == {shown.digest}
