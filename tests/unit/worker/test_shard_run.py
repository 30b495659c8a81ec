import errno
import hashlib
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from psycopg.errors import DiskFull
from service_factories import (
    TRACK,
    claim,
    make_failed_record,
    make_principal,
    make_record,
    make_upload,
    play,
    shard_ids,
    state_of,
    store,
    submit,
)
from small_disk import FILLER, fill, make_room, small_disk
from sqlalchemy import select
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session
from structlog.testing import capture_logs
from vitac.evaluator.episodes.records import EpisodeRecord, TrialEvidence, TrialVideo
from vitac.evaluator.figures.figures import FiguresPart
from vitac.evaluator.package_sets import digest_of_packages
from vitac.evaluator.regression import Coefficients
from vitac.evaluator.shards.host_process import ShardProcessFailed
from vitac.evaluator.shards.order import ShardOrder, ShardResult
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.server.competitions import sealing
from vitac.server.database.models import EpisodeResult, Evaluation, Shard, Submission, SubmissionFile
from vitac.server.database.states import EvaluationState, Role, WorkState
from vitac.server.errors import ProblemCode, ServiceError
from vitac.server.evaluations.episode_store import store_episodes
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.lifecycle import finish_shard
from vitac.server.principals import CONSOLE, Principal
from vitac.server.queue.leases import Lease
from vitac.server.services import Services
from vitac.server.storage.blobs import BlobStore, StoredFileLost
from vitac.server.submissions import creation, runs
from vitac.worker import leased_run, shard_run
from vitac.worker.leased_run import RunEnd
from vitac.worker.shard_run import ShardRun
from vitac.worker.staging import SubmissionStage
from worker_fakes import FakeShard, FakeShards, eventually

from competitions import make_competition, open_now, put_in_place, stored_stage


@pytest.fixture
def submission(services: Services, archive_sha256: str) -> Submission:
    with services.database.transaction() as session:
        upload = make_upload(archive_sha256=archive_sha256)
        return creation.create(session, make_principal(session), upload)[0]


@pytest.fixture
def stage(services: Services) -> Iterator[SubmissionStage]:
    stage = SubmissionStage(services.blobs, services.settings.scratch_dir, services.settings.limits)
    yield stage
    stage.close()


def first_shard(services: Services, submission: Submission) -> int:
    with services.database.transaction() as session:
        return shard_ids(session, submission)[0]


@pytest.fixture
def lease(services: Services, submission: Submission) -> Lease:
    return claim(services.database, first_shard(services, submission), lease_s=services.settings.lease_s)


def run_in_thread(run: ShardRun) -> Callable[[], RunEnd]:
    """Starts it; the returned function waits for its end."""
    ends: list[RunEnd] = []
    thread = threading.Thread(target=lambda: ends.append(run.run()))
    thread.start()

    def wait() -> RunEnd:
        thread.join(120.0)
        assert ends, "the run did not end"
        return ends[0]

    return wait


def stored_numbers(services: Services) -> list[int]:
    with services.database.transaction() as session:
        return sorted(session.scalars(select(EpisodeResult.episode)))


def test_shard_is_run_from_the_unpacked_submission_and_ended(
    services: Services, stage: SubmissionStage, lease: Lease
) -> None:
    shards = FakeShards()
    seen = []

    def gate(number: int) -> None:
        order = shards.started[0].order
        seen.append(order.kind is SubmissionKind.MODEL and (order.submission / "policy.py").is_file())

    shards.gate = gate
    assert ShardRun(services, stage, lease, shards).run() is RunEnd.FINISHED
    assert seen == [True] * 27
    assert stored_numbers(services) == list(range(1, 28))
    with services.database.transaction() as session:
        shard = session.get_one(Shard, lease.work_id)
        assert (shard.state, shard.isolation) == (
            WorkState.DONE,
            "user: root, memory: cgroup-v1, episodes: frozen-copy, files: disk, process ids repeat: True, "
            "episode period s: 0.0, kind: namespaces",
        )


def test_each_episode_is_stored_soon_after_it_is_over(
    services: Services, stage: SubmissionStage, lease: Lease, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shard_run, "TOGETHER_S", 0.01)

    def gate(number: int) -> None:
        eventually(lambda: stored_numbers(services) == list(range(1, number)))

    assert ShardRun(services, stage, lease, FakeShards(gate=gate)).run() is RunEnd.FINISHED


def test_packages_of_the_policy_are_stored_once_in_a_shard_and_again_where_storing_failed(
    services: Services, stage: SubmissionStage, lease: Lease, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = []

    def store(
        session: Session, lease: Lease, records: Sequence[EpisodeRecord], *, packages: dict[str, str] | None
    ) -> None:
        given.append(packages)
        if len(given) == 1:
            raise DBAPIError("INSERT", {}, DiskFull("no space left"))
        store_episodes(session, lease, records, packages=packages)

    monkeypatch.setattr(shard_run, "TOGETHER_S", 0.01)
    monkeypatch.setattr(shard_run, "store_episodes", store)
    shards = FakeShards(gate=lambda number: eventually(lambda: len(stored_numbers(services)) >= min(number - 1, 2)))
    assert ShardRun(services, stage, lease, shards).run() is RunEnd.FINISHED
    seen = {"numpy": "2.5.0"}
    assert given[:2] == [seen, seen]
    assert not any(given[2:])
    with services.database.transaction() as session:
        assert session.get_one(Evaluation, lease.evaluation_id).packages == [seen]
        assert session.get_one(Shard, lease.work_id).packages_digest == digest_of_packages(seen)


@pytest.mark.parametrize(
    ("learned", "record_of", "is_free"),
    [
        (None, make_record, True),
        (None, make_failed_record, False),
        (Coefficients(mesh_hash="0" * 64, starts=5, regressions=()), make_record, False),
    ],
    ids=["complete", "broken", "learned"],
)
def test_slot_is_left_before_the_result_is_stored_unless_the_next_shards_need_it(
    services: Services,
    stage: SubmissionStage,
    lease: Lease,
    monkeypatch: pytest.MonkeyPatch,
    learned: Coefficients | None,
    record_of: Callable[[int], EpisodeRecord],
    is_free: bool,
) -> None:
    places, seen = threading.Semaphore(0), []

    def finish(session: Session, lease: Lease, result: ShardResult) -> None:
        seen.append(places.acquire(blocking=False))
        finish_shard(session, lease, result)

    monkeypatch.setattr(shard_run, "finish_shard", finish)
    monkeypatch.setattr(ShardRun, "_keep", lambda *_: None)
    run = ShardRun(services, stage, lease, FakeShards(record_of, coefficients=learned), places.release)
    assert run.run() is RunEnd.FINISHED
    assert seen == [is_free]


def test_episodes_before_the_death_of_the_process_are_stored(
    services: Services, stage: SubmissionStage, lease: Lease
) -> None:
    def gate(number: int) -> None:
        if number == 4:
            raise ShardProcessFailed("The process of a shard ended with exit code -9.")

    assert ShardRun(services, stage, lease, FakeShards(gate=gate)).run() is RunEnd.BROKE
    assert stored_numbers(services) == [1, 2, 3]


def test_a_shard_of_a_sealed_list_gets_the_secret_in_a_file_that_goes_with_it(
    services: Services, stage: SubmissionStage, submission: Submission
) -> None:
    with services.database.transaction() as session:
        made = sealing.seal(session, CONSOLE, stored_stage(session, submission.track, "final"))
        evaluation = newest_evaluation(session, session.get_one(Submission, submission.id))
        evaluation.commitment = evaluation.shards[0].commitment = made.commitment
    lease = claim(services.database, first_shard(services, submission), lease_s=services.settings.lease_s)
    seen: list[tuple[Path, int, str]] = []
    shards = FakeShards()

    def gate(number: int) -> None:
        secret = shards.started[0].order.secret
        assert secret is not None
        seen.append((secret, secret.stat().st_mode & 0o777, secret.read_text()))

    shards.gate = gate
    assert ShardRun(services, stage, lease, shards).run() is RunEnd.FINISHED
    path, mode, text = seen[0]
    assert (mode, text) == (0o600, f"{made.secret}\n")
    assert path.is_relative_to(stage.folder)
    assert not path.exists()


@pytest.mark.parametrize("rules", [{}, {"episode_period_s": 0.5, "isolation": "vm"}])
def test_a_stage_says_when_episodes_start_and_what_isolates_them(
    services: Services, stage: SubmissionStage, archive_sha256: str, rules: dict[str, Any]
) -> None:
    content = open_now(make_competition())
    content["tracks"][TRACK]["stages"][0].update(rules)
    with services.database.transaction() as session:
        put_in_place(session, content)
        upload = make_upload(archive_sha256=archive_sha256)
        submission, _ = creation.create(session, make_principal(session), upload)
    lease = claim(services.database, first_shard(services, submission), lease_s=services.settings.lease_s)
    with services.database.transaction() as session:
        assert session.get_one(Shard, lease.work_id).requires.endswith(" vm") is ("isolation" in rules)
    shards = FakeShards()
    ShardRun(services, stage, lease, shards).run()
    order = shards.started[0].order
    assert {"episode_period_s": order.episode_period_s, "isolation": order.isolation} == {
        "episode_period_s": None, "isolation": None, **rules
    }  # fmt: skip


def test_half_done_shard_is_resumed_from_its_stored_episodes(
    services: Services, stage: SubmissionStage, lease: Lease
) -> None:
    store(services.database, lease, [make_record(3), make_failed_record(8)])
    shards = FakeShards()
    ShardRun(services, stage, lease, shards).run()
    order = shards.started[0].order
    assert order.skip == (3, 8)
    assert [failure.message for failure in order.earlier_failures] == ["failed in 8"]
    assert stored_numbers(services) == list(range(1, 28))


@contextmanager
def without_space(order: ShardOrder) -> Iterator[FakeShard]:
    """A process that comes to the end of the disk."""
    raise OSError(errno.ENOSPC, "No space left on device")
    yield


def test_shards_on_a_full_disk_wait_and_never_fail_an_evaluation(
    services: Services, stage: SubmissionStage, submission: Submission, monkeypatch: pytest.MonkeyPatch
) -> None:
    shard_id = first_shard(services, submission)
    with monkeypatch.context() as full:
        full.setattr(leased_run, "has_space", lambda _: False)
        for _ in range(2 * services.settings.shard_attempts):
            lease = claim(services.database, shard_id, lease_s=services.settings.lease_s)
            shards = FakeShards()
            assert ShardRun(services, stage, lease, shards).run() is RunEnd.HANDED_BACK
            assert shards.started == []
    with services.database.transaction() as session:
        assert newest_evaluation(session, submission).state is EvaluationState.RUNNING
    lease = claim(services.database, shard_id, lease_s=services.settings.lease_s)
    assert lease.attempt == 1
    assert ShardRun(services, stage, lease, FakeShards()).run() is RunEnd.FINISHED


def test_a_shard_that_fills_the_disk_each_time_ends_its_evaluation_by_name(
    services: Services, stage: SubmissionStage, submission: Submission
) -> None:
    shard_id = first_shard(services, submission)
    for _ in range(services.settings.shard_attempts):
        lease = claim(services.database, shard_id, lease_s=services.settings.lease_s)
        assert ShardRun(services, stage, lease, without_space).run() is RunEnd.BROKE
    with services.database.transaction() as session:
        ended = newest_evaluation(session, submission)
        assert (ended.verdict_code, ended.charged_at) == ("machine_failed", None)
        assert "No space left on device" in str(ended.verdict_message)
        noted = session.get_one(Shard, shard_id).repeats
        assert [each["cause"] for each in noted] == ["broke"] * (services.settings.shard_attempts - 1)
        assert all("No space left on device" in each["reason"] for each in noted)


def test_a_shard_waits_while_the_storage_has_no_space(
    services: Services, stage: SubmissionStage, submission: Submission
) -> None:
    @contextmanager
    def start(order: ShardOrder) -> Iterator[FakeShard]:
        full = ServiceError(ProblemCode.STORAGE_FULL, "The storage is full.")
        raise full from OSError(errno.ENOSPC, "No space left on device")
        yield

    for _ in range(2 * services.settings.shard_attempts):
        lease = claim(services.database, first_shard(services, submission), lease_s=services.settings.lease_s)
        assert ShardRun(services, stage, lease, start).run() is RunEnd.HANDED_BACK


def test_shard_whose_process_says_nothing_of_the_disk_waits_as_well_while_it_is_full(
    services: Services, stage: SubmissionStage, lease: Lease
) -> None:
    def gate(number: int) -> None:
        raise ShardProcessFailed("The process of a shard ended with exit code 1.")

    with small_disk(services.settings.scratch_dir, 2 << 20) as disk:
        other = SubmissionStage(services.blobs, disk, services.settings.limits)
        fill(disk)
        assert ShardRun(services, other, lease, FakeShards(gate=gate)).run() is RunEnd.HANDED_BACK
        assert [path for path in disk.rglob("*") if path.is_file() and path.name != FILLER] == []
        make_room(disk)
        assert ShardRun(services, other, claim_again(services, lease), FakeShards()).run() is RunEnd.FINISHED


def claim_again(services: Services, lease: Lease) -> Lease:
    return claim(services.database, lease.work_id, lease_s=services.settings.lease_s)


def test_shard_whose_episodes_are_all_stored_starts_no_process(
    services: Services, stage: SubmissionStage, submission: Submission, archive_sha256: str
) -> None:
    play(services.database, first_shard(services, submission))
    with services.database.transaction() as session:
        other = submit(session, make_principal(session, "Team B"))
    lease = claim(services.database, first_shard(services, other))
    shards = FakeShards()
    assert ShardRun(services, stage, lease, shards).run() is RunEnd.FINISHED
    assert shards.started == []


@pytest.mark.parametrize("kind", [SubmissionKind.LOG, SubmissionKind.TEXT_LOG])
def test_shard_of_a_log_gets_its_file_and_the_episodes_that_are_stored(
    services: Services, stage: SubmissionStage, lease: Lease, kind: SubmissionKind, archive_sha256: str
) -> None:
    store(services.database, lease, [make_record(3)])
    shards = FakeShards()
    seen: list[bytes] = []

    def gate(number: int) -> None:
        seen.append(shards.started[0].order.submission.read_bytes())

    shards.gate = gate
    assert ShardRun(services, stage, replace(lease, submission_kind=kind), shards).run() is RunEnd.FINISHED
    order = shards.started[0].order
    assert (order.kind, order.skip) == (kind, (3,))
    assert {hashlib.sha256(content).hexdigest() for content in seen} == {archive_sha256}
    assert stored_numbers(services) == list(range(1, 28))


def test_policy_that_breaks_a_shard_fails_the_evaluation(
    services: Services, stage: SubmissionStage, lease: Lease, submission: Submission
) -> None:
    shards = FakeShards(record_of=make_failed_record)
    assert ShardRun(services, stage, lease, shards).run() is RunEnd.FINISHED
    with services.database.transaction() as session:
        assert newest_evaluation(session, submission).state is EvaluationState.FAILED
    assert stored_numbers(services) == [1, 2, 3]


def test_cancel_kills_the_process_within_a_renewal(
    services: Services, stage: SubmissionStage, lease: Lease, submission: Submission
) -> None:
    running = threading.Event()
    shards = FakeShards()

    def gate(number: int) -> None:
        if number == 5:
            eventually(lambda: stored_numbers(services) == [1, 2, 3, 4])
            running.set()
            assert shards.started[0].killed.wait(120.0)

    shards.gate = gate
    wait = run_in_thread(ShardRun(services, stage, lease, shards))
    running.wait(120.0)
    with services.database.transaction() as session:
        runs.cancel(session, make_principal_of(submission), submission.id)
    assert wait() is RunEnd.LOST
    assert stored_numbers(services) == [1, 2, 3, 4]


def make_principal_of(submission: Submission) -> Principal:
    return Principal(role=Role.TEAM, team_id=submission.team_id, team_name="Team A")


def test_lease_is_kept_alive_during_a_long_episode(services: Services, stage: SubmissionStage, lease: Lease) -> None:
    def expiry() -> datetime:
        with services.database.transaction() as session:
            expires_at = session.get_one(Shard, lease.work_id).lease_expires_at
            assert expires_at is not None
            return expires_at

    first = expiry()

    def gate(number: int) -> None:
        if number == 1:
            eventually(lambda: expiry() > first)

    assert ShardRun(services, stage, lease, FakeShards(gate=gate)).run() is RunEnd.FINISHED


def test_stopped_worker_gives_the_shard_back_without_an_attempt(
    services: Services, stage: SubmissionStage, lease: Lease
) -> None:
    shards = FakeShards()
    running = threading.Event()

    def gate(number: int) -> None:
        if number == 3:
            running.set()
            assert shards.started[0].killed.wait(120.0)

    shards.gate = gate
    run = ShardRun(services, stage, lease, shards)
    wait = run_in_thread(run)
    running.wait(120.0)
    run.stop()
    assert wait() is RunEnd.HANDED_BACK
    with services.database.transaction() as session:
        shard = session.get_one(Shard, lease.work_id)
        assert (shard.state, shard.attempts) == (WorkState.QUEUED, 0)


def test_machine_that_cannot_run_a_shard_costs_an_attempt_and_the_third_ends_by_name(
    services: Services, stage: SubmissionStage, lease: Lease, submission: Submission
) -> None:
    def gate(number: int) -> None:
        raise ShardProcessFailed("SandboxFailed: bubblewrap did not start")

    for attempt in (1, 2, 3):
        assert lease.attempt == attempt
        assert ShardRun(services, stage, lease, FakeShards(gate=gate)).run() is RunEnd.BROKE
        if attempt < 3:
            lease = claim(services.database, lease.work_id)
    with services.database.transaction() as session:
        evaluation = newest_evaluation(session, submission)
        assert evaluation.state is EvaluationState.FAILED
        assert evaluation.verdict_code == "machine_failed"
        assert "bubblewrap did not start" in (evaluation.verdict_message or "")
        assert state_of(session, lease.work_id) is WorkState.CANCELLED


def test_a_trial_whose_video_was_changed_is_played_again(
    services: Services, stage: SubmissionStage, lease: Lease, tmp_path: Path
) -> None:
    file = tmp_path / "trial.mjpeg"
    file.write_bytes(b"of another station")
    sha256 = hashlib.sha256(b"of this one").hexdigest()
    video = TrialVideo(code="0123456789ABCDEF", frames=1, link=sha256, sha256=sha256, n_bytes=11)
    shards = FakeShards(record_of=partial(make_record, evidence=TrialEvidence(station="a", video=video)))

    @contextmanager
    def run(order: ShardOrder) -> Iterator[FakeShard]:
        with shards(order) as shard:
            shard.video = file
            yield shard

    assert ShardRun(services, stage, lease, run).run() is RunEnd.BROKE
    assert stored_numbers(services) == []
    with services.database.transaction() as session:
        (repeat,) = session.get_one(Shard, lease.work_id).repeats
    assert "has another SHA-256 than its record says" in repeat["reason"]


def test_process_that_hangs_is_ended_and_reported(
    services: Services, stage: SubmissionStage, lease: Lease, submission: Submission
) -> None:
    impatient = replace(
        services, settings=services.settings.model_copy(update={"shard_idle_timeout_s": 0.3, "shard_attempts": 1})
    )
    shards = FakeShards()

    def gate(number: int) -> None:
        if number == 1:
            assert shards.started[-1].killed.wait(120.0)

    shards.gate = gate
    assert ShardRun(impatient, stage, lease, shards).run() is RunEnd.BROKE
    assert stored_numbers(services) == []
    with services.database.transaction() as session:
        message = newest_evaluation(session, submission).verdict_message
    assert message is not None
    assert message.endswith("No episode ended within 0.3 s.")


def test_process_that_stored_episodes_before_it_hung_costs_no_attempt(
    services: Services, stage: SubmissionStage, lease: Lease, monkeypatch: pytest.MonkeyPatch
) -> None:
    impatient = replace(services, settings=services.settings.model_copy(update={"shard_attempts": 1}))
    shards, passed_s = FakeShards(), [0.0]
    monkeypatch.setattr(leased_run, "time", SimpleNamespace(monotonic=lambda: passed_s[0]))

    def gate(number: int) -> None:
        def is_ended() -> bool:
            passed_s[0] += 2 * services.settings.shard_idle_timeout_s
            return shards.started[-1].killed.is_set()

        if number == 4:
            eventually(is_ended)

    shards.gate = gate
    assert ShardRun(impatient, stage, lease, shards).run() is RunEnd.BROKE
    assert stored_numbers(services) == [1, 2, 3]
    with services.database.transaction() as session:
        shard = session.get_one(Shard, lease.work_id)
        assert (shard.state, shard.attempts) == (WorkState.QUEUED, 0)


def test_archive_that_is_gone_from_the_store_is_reported_as_a_broken_machine(
    services: Services, stage: SubmissionStage, lease: Lease
) -> None:
    services.blobs.delete(lease.archive_sha256)
    assert ShardRun(services, stage, lease, FakeShards()).run() is RunEnd.BROKE


class UnsteadyBlobs(BlobStore):
    """A storage that refuses the first times."""

    def __init__(self, blobs: BlobStore, refusals: list[ServiceError]) -> None:
        super().__init__(blobs._store)
        self.refusals = refusals

    def fetch(self, sha256: str, destination: Path) -> None:
        if self.refusals:
            raise self.refusals.pop()
        super().fetch(sha256, destination)


def unsteady(services: Services, *refusals: ServiceError) -> SubmissionStage:
    blobs = UnsteadyBlobs(services.blobs, list(refusals))
    return SubmissionStage(blobs, services.settings.scratch_dir, services.settings.limits)


AWAY = ServiceError(ProblemCode.STORAGE_UNAVAILABLE, "The file store does not work.")


def test_storage_that_is_away_is_waited_for_and_costs_no_attempt(
    services: Services, lease: Lease, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leased_run, "STORAGE_PAUSE_S", 0.01)
    stage = unsteady(services, *[AWAY] * 10)
    assert ShardRun(services, stage, lease, FakeShards()).run() is RunEnd.FINISHED
    assert stored_numbers(services) == sorted(lease.episodes)


def test_storage_that_is_away_when_the_figures_are_kept_is_waited_for(
    services: Services, stage: SubmissionStage, lease: Lease, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(leased_run, "STORAGE_PAUSE_S", 0.01)
    refusals, put = [AWAY] * 10, services.blobs.put

    def refuse_first(path: Path, sha256: str) -> None:
        if refusals:
            raise refusals.pop()
        put(path, sha256)

    monkeypatch.setattr(services.blobs, "put", refuse_first)
    part = FiguresPart(starts=(), problem="Start 1 could not be measured: ZeroDivisionError: no marker moves")
    with capture_logs() as logs:
        run = ShardRun(services, stage, lease, FakeShards(figures_of=lambda _: part))
        assert run.run() is RunEnd.FINISHED
    events = [line["event"] for line in logs]
    assert (events.count("figures_not_measured"), events.count("storage_unavailable")) == (1, 10)
    with services.database.transaction() as session:
        assert session.scalars(select(SubmissionFile.name)).all() == ["figures-part.json"]
        assert session.get_one(Shard, lease.work_id).state is WorkState.DONE


def test_worker_that_waits_for_the_storage_can_be_stopped(services: Services, lease: Lease) -> None:
    run = ShardRun(services, unsteady(services, *[AWAY] * 1000), lease, FakeShards())
    wait = run_in_thread(run)
    run.stop()
    assert wait() is RunEnd.HANDED_BACK


@pytest.mark.parametrize("refusal", [AWAY, StoredFileLost("The stored file is gone.")], ids=["away", "lost"])
def test_storage_that_stays_away_or_has_lost_the_file_is_reported(
    services: Services, lease: Lease, monkeypatch: pytest.MonkeyPatch, refusal: ServiceError
) -> None:
    monkeypatch.setattr(leased_run, "STORAGE_PATIENCE_S", -1.0 if refusal is AWAY else 600.0)
    assert ShardRun(services, unsteady(services, refusal), lease, FakeShards()).run() is RunEnd.BROKE
