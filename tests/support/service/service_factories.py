"""Makes teams, submissions and records for tests of the service, without any simulation."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from functools import cache
from typing import Any, Protocol
from uuid import UUID, uuid4

import numpy as np
from sqlalchemy import func, select, update
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session
from vitac.evaluator.agent.isolation.bubblewrap import UserIsolation
from vitac.evaluator.agent.isolation.cgroup import MemoryIsolation
from vitac.evaluator.agent.isolation.memory_files import FileIsolation
from vitac.evaluator.agent.session import EpisodeIsolation, Isolation
from vitac.evaluator.agent.verdicts import VerdictCode
from vitac.evaluator.episodes.records import (
    ActionSequence,
    EpisodeOutcome,
    EpisodeRecord,
    FailureStage,
    Manifest,
    PolicyFailure,
    Timings,
)
from vitac.evaluator.logs.findings import Divergence, LogFinding
from vitac.evaluator.scoring.score import Score, rate
from vitac.evaluator.shards.order import ShardEnd, ShardResult
from vitac.evaluator.submission_kinds import SubmissionKind
from vitac.evaluator.tracks import ListKind, find_task
from vitac.evaluator.tracks.registry import compute_hash, find_version
from vitac.evaluator.version import evaluator_hash, evaluator_version, platform_class
from vitac.server.accounts import teams, tokens
from vitac.server.cache import Cache
from vitac.server.database.engine import Database
from vitac.server.database.models import BoardResult, EpisodeResult, Evaluation, Shard, Submission, Team, Work
from vitac.server.database.states import EvaluationState, Role, WorkState
from vitac.server.evaluations import lifecycle
from vitac.server.evaluations.episode_store import row_values, store_episodes
from vitac.server.evaluations.history import newest_evaluation
from vitac.server.evaluations.logs import LogClaim
from vitac.server.evaluations.scores import store_scores
from vitac.server.leaderboards import board_cache, log_boards, standings
from vitac.server.leaderboards.board_cache import MadeBoards
from vitac.server.principals import CONSOLE, Principal
from vitac.server.queue import leases
from vitac.server.queue.leases import Lease
from vitac.server.queue.work import Claim
from vitac.server.settings import Settings
from vitac.server.submissions import creation, listing
from vitac.server.submissions.intake import CheckedUpload

TRACK = "track_1"
TASK = "peg-insertion"
LOCK = "lock-opening"
LEASE_S = 60.0
ISOLATION = Isolation(
    user=UserIsolation.ROOT,
    memory=MemoryIsolation.CGROUP_V1,
    episodes=EpisodeIsolation.FROZEN_COPY,
    files=FileIsolation.DISK,
    process_ids_repeat=True,
)

ADD_EPISODES = insert(EpisodeResult.metadata.tables[EpisodeResult.__tablename__]).on_conflict_do_nothing()
"""Built once, and for the table: the ORM's own insert takes twice as long with the rows of an evaluation."""


def sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def make_settings(**values: Any) -> Settings:
    return Settings(**values)


def forget_boards() -> None:
    """Lets this process read all boards anew: also those of a copy of a database, and after changes without a note.

    The same goes for the ends of episodes, whose names a copy of the seed shares with the others.
    """
    board_cache._cache = Cache(at_most=200)
    standings._made_boards = MadeBoards()
    log_boards._made_boards = MadeBoards()
    listing._ends = Cache(at_most=128)


def make_principal(session: Session, team: str = "Team A") -> Principal:
    registered = teams.register(session, CONSOLE, name=team)
    return Principal(role=Role.TEAM, team_id=registered.id, team_name=registered.name, leads_team=True)


def make_secret(session: Session, principal: Principal) -> str:
    owner = teams.own(session, principal) if principal.team_id is not None else None
    assert principal.role is not None
    return tokens.issue(session, CONSOLE, role=principal.role, label="test", team=owner, lifetime=None).secret


def make_upload(content: str = "content", **changes: Any) -> CheckedUpload:
    values: dict[str, Any] = {
        "kind": SubmissionKind.MODEL,
        "track": TRACK,
        "tasks": (TASK,),
        "name": "zero",
        "digest": sha256(content),
        "archive_sha256": sha256(f"zip of {content}"),
        "archive_bytes": 100,
        "manifest": {"track": TRACK, "name": "zero"},
    }
    return CheckedUpload(**(values | changes))


def submit(
    session: Session, principal: Principal, content: str = "content", tasks: Iterable[str] = (TASK,), **options: Any
) -> Submission:
    return creation.create(session, principal, make_upload(content, tasks=tuple(tasks)), **options)[0]


def submit_to(session: Session, principal: Principal, *, track: str, task: str) -> Submission:
    """A submission to another track."""
    upload = make_upload(track=track, tasks=(task,), manifest={"track": track, "name": "zero"})
    return creation.create(session, principal, upload)[0]


def make_score(successes: int, episodes: int = 100, mean_steps: float | None = 4.0) -> Score:
    return Score(**dict(rate(successes, episodes)), mean_steps=mean_steps, by_shape={}, outcomes={})


def submit_scored(
    session: Session,
    principal: Principal,
    name: str,
    scores: Mapping[str, Score],
    at: datetime | None = None,
    **changes: Any,
) -> Submission:
    """A submission whose evaluation is complete with these scores, without the episodes behind them."""
    upload = make_upload(name, name=name, tasks=tuple(scores), **changes)
    submission = creation.create(session, principal, upload, at=at)[0]
    complete_scored(session, submission, scores)
    return submission


def complete_scored(session: Session, submission: Submission, scores: Mapping[str, Score]) -> None:
    """Completes the newest evaluation of a submission with these scores."""
    evaluation = newest_evaluation(session, submission)
    evaluation.state = EvaluationState.RUNNING
    session.flush()
    finished_at = datetime.now(UTC)
    hashes = {task: sha256(f"{submission.name} {task}") for task in scores}
    store_scores(session, evaluation, scores, hashes, finished_at=finished_at)
    evaluation.result_hash = sha256(submission.name)
    evaluation.finished_at = finished_at
    evaluation.state = EvaluationState.COMPLETED


def add_result(
    session: Session,
    number: int,
    team: Team,
    played: dict[str, Score],
    moment: datetime,
    version: str = evaluator_version(),
    kind: SubmissionKind = SubmissionKind.MODEL,
    evaluation_id: UUID | None = None,
) -> Evaluation:
    """A completed evaluation without shards, jobs and episodes."""
    digest = sha256(f"{team.id} {number}")
    submission = Submission(
        team=team, kind=kind, track=TRACK, tasks=list(played), name=str(number), digest=digest,
        archive_sha256=digest, archive_bytes=1, manifest={}, submitted_at=moment,
    )  # fmt: skip
    session.add(submission)
    session.flush()
    evaluation = Evaluation(
        id=evaluation_id, submission=submission, run=1, evaluator_version=version, evaluator_hash=evaluator_hash(),
        state=EvaluationState.COMPLETED, episodes_reused=0, log_tail="", created_at=moment, finished_at=moment,
        result_hash=digest, list_kind=ListKind.PUBLIC,
    )  # fmt: skip
    store_scores(session, evaluation, played, dict.fromkeys(played, digest), finished_at=moment)
    session.add(evaluation)
    session.flush()
    return evaluation


def submit_refuted_log(session: Session, principal: Principal, name: str) -> Submission:
    """A log whose evaluation has ended because its first episode led elsewhere, without the episodes played."""
    claim = LogClaim(team=None, episodes=270, successes=1, success_rate=1 / 270, mean_steps=3.0)
    upload = make_upload(name, name=name, kind=SubmissionKind.LOG, manifest=claim.stored())
    submission = creation.create(session, principal, upload)[0]
    evaluation = newest_evaluation(session, submission)
    evaluation.state = EvaluationState.RUNNING
    session.flush()
    divergence = Divergence(
        episode=1, env_step=1, recorded_state=None, recorded_info=None, resimulated_state=None, resimulated_info=None
    )
    finding = LogFinding.diverged(divergence)
    for shard in evaluation.shards:
        shard.state, shard.finding = WorkState.FAILED, finding.model_dump(mode="json")
    evaluation.verdict_code, evaluation.verdict_message = finding.verdict.value, finding.reason
    evaluation.finished_at = datetime.now(UTC)
    evaluation.state = EvaluationState.FAILED
    return submission


def outdate(session: Session, version: str = "0+old") -> None:
    """Makes all evaluations those of another evaluator version."""
    for table in (Evaluation, BoardResult):
        session.execute(update(table).values(evaluator_version=version))


def make_record(
    episode: int, outcome: EpisodeOutcome = EpisodeOutcome.SUCCESS, task: str = TASK, **changes: Any
) -> EpisodeRecord:
    return _changed_record(episode, outcome, task, **changes) if changes else _record(episode, outcome, task)


@cache
def _record(episode: int, outcome: EpisodeOutcome, task: str) -> EpisodeRecord:
    return _changed_record(episode, outcome, task)


def _changed_record(episode: int, outcome: EpisodeOutcome, task: str, **changes: Any) -> EpisodeRecord:
    listed = find_task(task)[1].episodes[episode - 1]
    values: dict[str, Any] = {
        "episode": episode,
        "task": task,
        "shape": listed.shape,
        "initial_offset": listed.offset,
        "outcome": outcome,
        "env_steps": 3,
        "total_reward": 1.0,
        "actions": _equal_actions(episode / 1000),
        "state_hashes": tuple(sha256(f"{episode} {step}") for step in range(4)),
        "infos": ({},) * 3,
        "timings": Timings(wall_s=0.5),
    }
    return EpisodeRecord(**(values | changes))


def make_failed_record(
    episode: int,
    *,
    stage: FailureStage = FailureStage.EPISODE,
    code: VerdictCode = VerdictCode.CRASHED,
    output: str = "Traceback",
    task: str = TASK,
) -> EpisodeRecord:
    failure = PolicyFailure(stage=stage, code=code, message=f"failed in {episode}", output_tail=output)
    return make_record(episode, EpisodeOutcome.POLICY_FAILED, task, failure=failure)


def make_manifest(task: str = TASK) -> Manifest:
    track = find_task(task)[0].name
    return Manifest(
        track=track,
        task=task,
        list_seed=0,
        task_hash=sha256("task"),
        evaluator_version=find_version(track),
        evaluator_hash=compute_hash(track),
        solver_version="1",
        mesh_hash=sha256("mesh"),
        platform_class=platform_class(),
    )


def shard_ids(session: Session, submission: Submission) -> list[int]:
    newest = newest_evaluation(session, submission)
    return [shard.id for shard in sorted(newest.shards, key=lambda shard: shard.id)]


def take(session: Session, work_id: int, worker_id: UUID | None = None, lease_s: float = LEASE_S) -> Claim:
    """A claim of one piece of work, whatever else waits."""
    found = session.get_one(Work, work_id, populate_existing=True, with_for_update=True)
    assert found.state is WorkState.QUEUED
    now = session.scalars(select(func.clock_timestamp())).one()
    found.state, found.worker_id = WorkState.RUNNING, worker_id or uuid4()
    found.token, found.attempts = found.token + 1, found.attempts + 1
    found.started_at = found.progressed_at = now
    found.lease_expires_at = now + timedelta(seconds=lease_s)
    session.flush()
    waited_s = (now - found.queued_at).total_seconds()
    return Claim(work_id=work_id, kind=found.kind, token=found.token, attempt=found.attempts, waited_s=waited_s)


def take_shard(session: Session, shard_id: int, worker_id: UUID | None = None, lease_s: float = LEASE_S) -> Lease:
    """The lease on one shard, whatever else waits."""
    return leases.begin(session, take(session, shard_id, worker_id, lease_s))


def claim(database: Database, shard_id: int, worker_id: UUID | None = None, lease_s: float = LEASE_S) -> Lease:
    with database.transaction() as session:
        return take_shard(session, shard_id, worker_id, lease_s)


def take_away(database: Database, shard_id: int) -> None:
    """What the sweep does with a shard whose lease has run out."""
    with database.transaction() as session:
        shard = session.get_one(Shard, shard_id)
        shard.state, shard.lease_expires_at, shard.worker_id = WorkState.QUEUED, None, None


def store(database: Database, lease: Lease, records: Iterable[EpisodeRecord]) -> None:
    for record in records:
        with database.transaction() as session:
            store_episodes(session, lease, [record])


def finish(database: Database, lease: Lease, end: ShardEnd = ShardEnd.COMPLETE) -> None:
    with database.transaction() as session:
        finish_within(session, lease, end)


def finish_within(session: Session, lease: Lease, end: ShardEnd = ShardEnd.COMPLETE) -> None:
    lifecycle.finish_shard(session, lease, make_result(lease.number, lease.task, end))


def make_result(number: int, task: str, end: ShardEnd = ShardEnd.COMPLETE) -> ShardResult:
    return ShardResult(index=number, end=end, manifest=make_manifest(task), isolation=ISOLATION)


class RecordOf(Protocol):
    """Makes up the record of an episode of a task."""

    def __call__(self, episode: int, *, task: str) -> EpisodeRecord: ...


def successes_below(limit: int) -> RecordOf:
    """Records of a policy of its own, which solves the episodes below the limit."""
    return lambda n, task: own_record(limit, n, EpisodeOutcome.SUCCESS if n < limit else EpisodeOutcome.STEPS, task)


def own_record(policy: int, number: int, outcome: EpisodeOutcome, task: str = TASK) -> EpisodeRecord:
    """The record of a policy with actions and states of its own, so that it is no copy of another one."""
    sign = 1 - 2 * (number * policy // 7 % 2)
    # A copy, as most of the time of an evaluation's records goes into checking what is right.
    return make_record(number, outcome, task).model_copy(
        update={
            "actions": _equal_actions(sign * policy / 300),
            "state_hashes": tuple(sha256(f"{policy} {number} {step}") for step in range(4)),
        }
    )


@cache
def _equal_actions(value: float) -> ActionSequence:
    """Three actions of three equal numbers."""
    return ActionSequence.from_array(np.full((3, 3), value, np.float32))


def play(
    database: Database, shard_id: int, record_of: RecordOf = make_record, *, worker_id: UUID | None = None
) -> None:
    """Runs a shard from claim to end; all its episodes are stored at once, which is quicker than a worker."""
    with database.transaction() as session:
        play_within(session, shard_id, record_of, worker_id)


def play_all(database: Database, submission: Submission, record_of: RecordOf = make_record) -> None:
    """Runs all shards of its newest evaluation, of one list after the other, in one transaction."""
    with database.transaction() as session:
        played: set[int] = set()
        while waiting := [shard_id for shard_id in shard_ids(session, submission) if shard_id not in played]:
            play_together(session, waiting, record_of)
            played.update(waiting)


def play_public_list(database: Database, submission: Submission) -> list[int]:
    """Runs what its newest evaluation plays first, and returns the shards of the sealed list, which follow."""
    with database.transaction() as session:
        first = shard_ids(session, submission)
        play_together(session, first, make_record)
        return [shard_id for shard_id in shard_ids(session, submission) if shard_id not in first]


def play_together(session: Session, waiting: Sequence[int], record_of: RecordOf) -> None:
    """Runs queued shards of one list, the last as a worker does; the others are ended together, without claims."""
    *others, last = waiting
    lease = take_shard(session, last)
    shards = session.scalars(select(Shard).where(Shard.id.in_(others)).order_by(Shard.id)).all()
    parts = [*((shard.task, shard.episodes) for shard in shards), (lease.task, lease.episodes)]
    rows = [row_values(lease, record_of(episode, task=task)) for task, episodes in parts for episode in episodes]
    session.execute(ADD_EPISODES, rows)
    for shard in shards:
        shard.state, shard.worker_id, shard.token, shard.attempts = WorkState.RUNNING, uuid4(), 1, 1
        shard.started_at = shard.progressed_at = shard.lease_expires_at = shard.queued_at
        shard.manifest = make_manifest(shard.task).model_dump(mode="json")
        shard.isolation = leases._read_isolation(make_result(shard.number, shard.task))
    session.flush()
    for shard in shards:
        shard.state, shard.lease_expires_at, shard.finished_at = WorkState.DONE, None, shard.queued_at
    session.flush()
    finish_within(session, lease)


def play_within(session: Session, shard_id: int, record_of: RecordOf, worker_id: UUID | None = None) -> None:
    lease = take_shard(session, shard_id, worker_id)
    rows = [row_values(lease, record_of(episode, task=lease.task)) for episode in lease.episodes]
    session.execute(ADD_EPISODES, rows)
    finish_within(session, lease)


def state_of(session: Session, shard_id: int) -> Any:
    return session.get_one(Shard, shard_id, populate_existing=True).state
