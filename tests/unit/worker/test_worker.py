import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from uuid import uuid4

import pytest
from asked_playbacks import played
from service_factories import make_principal, make_record, make_upload, shard_ids
from sqlalchemy import select, text
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.playback.order import SCENE_FILE, PlaybackOrder
from vitac.evaluator.shards.order import ShardOrder
from vitac.server.accounts.principals import CONSOLE
from vitac.server.db.models import EpisodeResult, Playback, Shard, Submission
from vitac.server.db.states import EvaluationState, PlaybackState, ShardState
from vitac.server.evaluations.episode_store import store_episodes
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.housekeeping import Housekeeping
from vitac.server.metrics.totals import SeriesKey, totals
from vitac.server.queue import leases
from vitac.server.services import Services
from vitac.server.submissions import creation, runs
from vitac.worker.staging import SubmissionStage
from vitac.worker.worker import QueueWorker
from worker_fakes import FakeShards, eventually


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
    thread = threading.Thread(target=lambda: asyncio.run(worker.run()))
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
        assert session.scalar(text("SELECT count(*) FROM procrastinate_jobs")) == 0


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
        assert (first.state, first.attempts) == (ShardState.QUEUED, 0)
    again = FakeShards()
    with working(services, again):
        eventually(lambda: state(services, submission) is EvaluationState.COMPLETED)
    assert again.started[0].order.skip == (1, 2, 3, 4)


def test_shard_of_a_lost_worker_goes_to_another_one_which_resumes_it(services: Services, archive_sha256: str) -> None:
    submission = submit(services, archive_sha256)
    with services.database.transaction() as session:
        lost = leases.claim(session, shard_ids(session, submission)[0], uuid4(), 0.2)
        assert lost is not None
        store_episodes(session, lost, [make_record(1)])
        first_job = text("DELETE FROM procrastinate_jobs WHERE (args ->> 'shard_id')::bigint = :shard")
        session.execute(first_job, {"shard": lost.shard_id})
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


def test_worker_makes_playbacks_when_no_shard_waits(services: Services, archive_sha256: str) -> None:
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
        eventually(lambda: state_of_playback(services, playback.id) is PlaybackState.MADE)
    assert state(services, team.submission) is EvaluationState.COMPLETED
    assert order[-1] == "playback"
    assert order.count("playback") == 1


def state_of_playback(services: Services, playback_id: int) -> PlaybackState:
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
