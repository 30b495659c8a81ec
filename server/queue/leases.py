"""Leases on shards: claim, renewal, storing of episodes, and the ways in which a lease ends.

Each claim raises the shard's token. Every later statement names the token, so a worker that was paused, and whose shard
went to another one, changes nothing any more: its next statement raises `LeaseLost`.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import timedelta
from typing import Any
from uuid import UUID

import structlog
from sqlalchemy import Interval, cast, func, select, update
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.orm import Session
from vitac.envs.errors import VitacError
from vitac.evaluator.episodes.records import EpisodeRecord, Manifest, PolicyFailure
from vitac.evaluator.shards.result import ShardResult
from vitac.server.db.models import EpisodeResult, Evaluation, Shard, Submission
from vitac.server.db.states import EvaluationState, ShardState, SubmissionKind

from .jobs import ONCE_MORE, enqueue_shards

logger = structlog.get_logger(__name__)


class LeaseLost(VitacError):
    """The shard belongs to another worker or its evaluation has ended: stop working on it and report nothing."""


@dataclass(frozen=True, kw_only=True)
class EpisodeKey:
    """What episode rows of one evaluation have in common; an episode is computed once for each such key."""

    submission_digest: str
    evaluator_version: str
    track: str
    run: int

    def conditions(self) -> tuple[Any, ...]:
        """Return the key as conditions on `EpisodeResult`."""
        return (
            EpisodeResult.submission_digest == self.submission_digest,
            EpisodeResult.evaluator_version == self.evaluator_version,
            EpisodeResult.track == self.track,
            EpisodeResult.run == self.run,
        )


@dataclass(frozen=True, kw_only=True)
class Lease:
    """The right to work on one shard, and all that is needed for it."""

    shard_id: int
    token: int
    attempt: int
    evaluation_id: UUID
    key: EpisodeKey
    kind: SubmissionKind
    archive_sha256: str
    task: str
    number: int
    episodes: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class StoredEpisodes:
    """What is known of a shard before it runs."""

    numbers: frozenset[int]
    failures: tuple[PolicyFailure, ...]


def key_of(evaluation: Evaluation, submission: Submission) -> EpisodeKey:
    """Key of an evaluation's episodes."""
    return EpisodeKey(
        submission_digest=submission.digest,
        evaluator_version=evaluation.evaluator_version,
        track=submission.track,
        run=evaluation.run,
    )


def claim(session: Session, shard_id: int, worker_id: UUID, lease_s: float) -> Lease | None:
    """Take a queued shard; None when there is nothing to do (taken, finished, cancelled).

    A running shard is not taken away here: the sweep queues it again when its lease has run out.
    """
    evaluation = _lock_evaluation_of(session, shard_id)
    if evaluation is None:
        return None
    shard = session.get(Shard, shard_id, with_for_update=True, populate_existing=True)
    if shard is None or shard.state is not ShardState.QUEUED:
        return None
    now = session.scalars(select(func.clock_timestamp())).one()
    shard.state = ShardState.RUNNING
    shard.token += 1
    shard.attempts += 1
    shard.worker_id = worker_id
    shard.lease_expires_at = now + timedelta(seconds=lease_s)
    shard.started_at = now
    if evaluation.state is EvaluationState.QUEUED:
        evaluation.state = EvaluationState.RUNNING
        evaluation.started_at = now
    submission = evaluation.submission
    return Lease(
        shard_id=shard.id,
        token=shard.token,
        attempt=shard.attempts,
        evaluation_id=evaluation.id,
        key=key_of(evaluation, submission),
        kind=submission.kind,
        archive_sha256=submission.archive_sha256,
        task=shard.task,
        number=shard.number,
        episodes=tuple(shard.episodes),
    )


def renew(session: Session, lease: Lease, lease_s: float) -> None:
    """Keep the shard for another while.

    Raises:
        LeaseLost: it is not ours any more, for example because the evaluation was cancelled.
    """
    _change_held(session, lease, lease_expires_at=_lease_end(lease_s))


def store_episode(session: Session, lease: Lease, record: EpisodeRecord) -> None:
    """Store a finished episode; storing it again writes nothing.

    Raises:
        LeaseLost: the shard is not ours any more.
    """
    _lock_held(session, lease)
    record = printable(record)
    digest = record.record_digest()
    added = session.scalar(
        insert(EpisodeResult)
        .values(
            submission_digest=lease.key.submission_digest,
            evaluator_version=lease.key.evaluator_version,
            track=lease.key.track,
            task=record.task,
            episode=record.episode,
            run=lease.key.run,
            outcome=record.outcome.value,
            success=record.success,
            env_steps=record.env_steps,
            record=record.model_dump(mode="json"),
            record_digest=digest,
            wall_s=record.timings.wall_s,
            evaluation_id=lease.evaluation_id,
        )
        .on_conflict_do_nothing(constraint="uq_episode_results_key")
        .returning(EpisodeResult.id)
    )
    if added is None:
        _report_difference(session, lease, record, digest)


def printable(record: EpisodeRecord) -> EpisodeRecord:
    """Return the record without characters that the database cannot hold; a policy may print whatever it likes."""
    if record.failure is None:
        return record
    cleaned = {name: _storable(getattr(record.failure, name)) for name in ("message", "output_tail")}
    return record.model_copy(update={"failure": record.failure.model_copy(update=cleaned)})


def stored_episodes(session: Session, lease: Lease) -> StoredEpisodes:
    """Which episodes of the shard need not be played, and how the policy failed in them."""
    rows = session.scalars(
        select(EpisodeResult).where(
            *lease.key.conditions(), EpisodeResult.task == lease.task, EpisodeResult.episode.in_(lease.episodes)
        )
    ).all()
    records = [EpisodeRecord.model_validate(row.record) for row in sorted(rows, key=lambda row: row.episode)]
    return StoredEpisodes(
        numbers=frozenset(record.episode for record in records),
        failures=tuple(record.failure for record in records if record.failure is not None),
    )


def known_manifest(session: Session, lease: Lease) -> Manifest | None:
    """Return what this evaluator version plays the task with, from any shard that has said so."""
    found = session.scalar(
        select(Shard.manifest)
        .join(Evaluation)
        .join(Submission)
        .where(
            Evaluation.evaluator_version == lease.key.evaluator_version,
            Submission.track == lease.key.track,
            Shard.task == lease.task,
            Shard.manifest.is_not(None),
        )
        .limit(1)
    )
    return Manifest.model_validate(found) if found is not None else None


def end_shard(session: Session, lease: Lease, state: ShardState, result: ShardResult) -> None:
    """Mark the shard as done or failed.

    Raises:
        LeaseLost: the shard is not ours any more.
    """
    _change_held(
        session,
        lease,
        state=state,
        manifest=result.manifest.model_dump(mode="json"),
        isolation=_isolation_of(result),
        finding=result.finding.model_dump(mode="json") if result.finding else None,
        lease_expires_at=None,
        finished_at=func.clock_timestamp(),
    )


def hand_back(session: Session, lease: Lease, *, counts_as_attempt: bool, delay_s: float = 0.0) -> None:
    """Queues the shard again for whoever comes first (after a while), for example when the worker is told to stop.

    Raises:
        LeaseLost: the shard is not ours any more.
    """
    _change_held(
        session,
        lease,
        state=ShardState.QUEUED,
        attempts=Shard.attempts if counts_as_attempt else Shard.attempts - 1,
        lease_expires_at=None,
        worker_id=None,
        queued_at=func.clock_timestamp(),
    )
    enqueue_shards(session, [lease.shard_id], lease.key.evaluator_version, delay_s=delay_s, priority=ONCE_MORE)


def lock_evaluation(session: Session, evaluation_id: UUID) -> Evaluation:
    """Return the evaluation, locked. Always locked before its shards, so that no two transactions wait for each other.

    The lock leaves foreign keys alone: storing an episode only holds its shard and refers to the evaluation.
    """
    return session.scalars(
        select(Evaluation)
        .where(Evaluation.id == evaluation_id)
        .with_for_update(key_share=True)
        .execution_options(populate_existing=True)
    ).one()


def _storable(text: str) -> str:
    return text.replace("\0", "\N{REPLACEMENT CHARACTER}").encode("utf-8", "replace").decode("utf-8")


def _isolation_of(result: ShardResult) -> str | None:
    """Return the level of isolation as one string; None when no policy ran because all episodes were stored."""
    if result.isolation is None:
        return None
    return ", ".join(f"{name.replace('_', ' ')}: {value}" for name, value in asdict(result.isolation).items())


def _lock_evaluation_of(session: Session, shard_id: int) -> Evaluation | None:
    evaluation_id = session.scalar(select(Shard.evaluation_id).where(Shard.id == shard_id))
    return lock_evaluation(session, evaluation_id) if evaluation_id is not None else None


def _held(lease: Lease) -> Sequence[Any]:
    return (Shard.id == lease.shard_id, Shard.token == lease.token, Shard.state == ShardState.RUNNING)


def _lock_held(session: Session, lease: Lease) -> None:
    if session.scalar(select(Shard.id).where(*_held(lease)).with_for_update()) is None:
        raise _lost(lease)


def _change_held(session: Session, lease: Lease, **values: Any) -> None:
    changed = session.scalar(
        update(Shard)
        .where(*_held(lease))
        .values(**values)
        .returning(Shard.id)
        .execution_options(synchronize_session=False)
    )
    if changed is None:
        raise _lost(lease)


def _lease_end(lease_s: float) -> Any:
    return func.clock_timestamp() + cast(timedelta(seconds=lease_s), Interval)


def _lost(lease: Lease) -> LeaseLost:
    return LeaseLost(f"Shard {lease.shard_id} is not held under token {lease.token} any more.")


def _report_difference(session: Session, lease: Lease, record: EpisodeRecord, digest: str) -> None:
    stored = session.scalar(
        select(EpisodeResult.record_digest).where(
            *lease.key.conditions(), EpisodeResult.task == record.task, EpisodeResult.episode == record.episode
        )
    )
    if stored != digest:
        # The first one counts. Different records under one key: a policy or a machine that does not repeat itself.
        logger.warning("episode_differs_from_stored", shard=lease.shard_id, episode=record.episode, kept=stored)
