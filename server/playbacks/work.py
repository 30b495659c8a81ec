"""The work on playbacks: claim, renewal, and the ways in which it ends. Called by the workers and the housekeeping.

As with shards, each claim raises the token, and every later statement names it: who was paused changes nothing.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import structlog
from sqlalchemy import delete, func, select, update
from sqlalchemy.orm import Session
from vitac.evaluator.episodes.records import EpisodeRecord

from ..competitions.sealing import derive_list_seed
from ..database.models import EpisodeResult, Playback, Submission, SubmissionFile, Worker
from ..database.states import OPEN_PLAYBACK_STATES, FileRole, PlaybackState, WorkerState
from ..queue.jobs import enqueue_playback, forget_jobs_of_ended_playbacks, has_waiting_playback_job
from ..queue.leases import LeaseLost, lease_end
from ..settings import Settings
from ..tracks import find_playback_family
from .asking import playback_queue

logger = structlog.get_logger(__name__)

UNMADE_KEPT = timedelta(hours=1)
"""How long a playback waits for a worker that can make it, after it was asked for and after the last such worker."""


@dataclass(frozen=True, kw_only=True)
class PlaybackLease:
    """The right to make one playback, and all that is needed for it.

    Attributes:
        list_seed: of the sealed list that was played; None for the public one.
        sensor_sha256: of the sensor that was played with; None for the challenge's.
    """

    playback_id: int
    token: int
    attempt: int
    evaluator_version: str
    track: str
    record: EpisodeRecord
    list_seed: int | None = None
    sensor_sha256: str | None = None


def claim(session: Session, playback_id: int, lease_s: float) -> PlaybackLease | None:
    """Take a queued playback; None where there is nothing to do (taken, made, removed)."""
    playback = session.get(Playback, playback_id, with_for_update=True, populate_existing=True)
    if playback is None or playback.state is not PlaybackState.QUEUED:
        return None
    playback.state = PlaybackState.RUNNING
    playback.token += 1
    playback.attempts += 1
    playback.env_steps_played = 0
    playback.lease_expires_at = lease_end(lease_s)
    episode = playback.episode
    return PlaybackLease(
        playback_id=playback.id,
        token=playback.token,
        attempt=playback.attempts,
        evaluator_version=playback.evaluator_version,
        track=episode.track,
        record=EpisodeRecord.model_validate(episode.record),
        list_seed=derive_list_seed(session, episode.commitment, episode.track, episode.task),
        sensor_sha256=_find_sensor(session, episode),
    )


def renew(session: Session, lease: PlaybackLease, lease_s: float, *, env_steps_played: int) -> None:
    """Keep the playback for another while and say how far it is.

    Raises:
        LeaseLost: it is no longer ours.
    """
    _change_held(session, lease, lease_expires_at=lease_end(lease_s), env_steps_played=env_steps_played)


def end_made(session: Session, lease: PlaybackLease, digests: Mapping[str, str]) -> None:
    """Mark the playback as made.

    Args:
        session: of the transaction.
        lease: on the playback.
        digests: SHA-256 of the stored files by column.

    Raises:
        LeaseLost: it is no longer ours.
    """
    _end(session, lease, state=PlaybackState.MADE, env_steps_played=lease.record.env_steps, **digests)


def end_failed(session: Session, lease: PlaybackLease, problem: str) -> None:
    """Mark the playback as one that cannot be made.

    Raises:
        LeaseLost: it is no longer ours.
    """
    _end(session, lease, state=PlaybackState.FAILED, problem=problem)


def hand_back(session: Session, lease: PlaybackLease, *, counts_as_attempt: bool, delay_s: float = 0.0) -> None:
    """Queue the playback again for the next free worker, after a while.

    Raises:
        LeaseLost: it is no longer ours.
    """
    _change_held(
        session,
        lease,
        state=PlaybackState.QUEUED,
        attempts=lease.attempt - (0 if counts_as_attempt else 1),
        lease_expires_at=None,
    )
    queue = playback_queue(lease.evaluator_version, lease.track, lease.record.task)
    enqueue_playback(session, lease.playback_id, queue, delay_s=delay_s)


def recover(session: Session, settings: Settings) -> int:
    """Queue playbacks again whose worker was lost; how many.

    Those that were lost too often, or that no worker can make, are given up; those without a job get one.
    """
    now = datetime.now(UTC)
    _give_up_unmade(session, now)
    lost = session.scalars(
        select(Playback)
        .where(Playback.state == PlaybackState.RUNNING, Playback.lease_expires_at < func.clock_timestamp())
        .with_for_update(skip_locked=True)
    ).all()
    for playback in lost:
        playback.token += 1
        playback.lease_expires_at = None
        if playback.attempts < settings.shard_attempts:
            playback.state = PlaybackState.QUEUED
            continue
        _give_up(playback, now, f"It was started {playback.attempts} times, and each time the worker was lost.")
    session.flush()
    waiting = session.scalars(
        select(Playback).where(
            Playback.state == PlaybackState.QUEUED,
            Playback.asked_at < now - timedelta(seconds=settings.lease_s),
            ~has_waiting_playback_job(),
        )
    ).all()
    for playback in waiting:
        queue = playback_queue(playback.evaluator_version, playback.episode.track, playback.episode.task)
        enqueue_playback(session, playback.id, queue)
    forget_jobs_of_ended_playbacks(session)
    return len(lost)


def remove_old(session: Session, settings: Settings) -> None:
    """Remove playbacks that were asked for long ago; they are made again when somebody wants to see them."""
    oldest = datetime.now(UTC) - timedelta(days=settings.playbacks_kept_days)
    session.execute(delete(Playback).where(Playback.asked_at < oldest, Playback.state.not_in(OPEN_PLAYBACK_STATES)))


def stored_digests(session: Session) -> set[str]:
    """Return the SHA-256 of all files of playbacks."""
    files = (Playback.scene_sha256, Playback.cameras_sha256, Playback.still_sha256, Playback.film_sha256)
    rows = session.execute(select(*files)).all()
    return {digest for row in rows for digest in row if digest is not None}


def _give_up_unmade(session: Session, now: datetime) -> None:
    """Give up playbacks that no worker can make: each counts against the limits of who asked for it as it waits."""
    oldest = now - UNMADE_KEPT
    overdue = (Playback.state == PlaybackState.QUEUED, Playback.asked_at < oldest)
    waiting = session.scalars(select(Playback).where(*overdue).with_for_update(skip_locked=True)).all()
    if not waiting:
        return
    there = (Worker.heartbeat_at > oldest, Worker.state != WorkerState.REFUSING)
    rows = session.execute(select(Worker.evaluator_version, Worker.families).where(*there)).all()
    made = {(version, family) for version, families in rows for family in families}
    for playback in waiting:
        needed = (playback.evaluator_version, find_playback_family(playback.episode.track, playback.episode.task))
        if needed not in made:
            _give_up(playback, now, "No worker that can make it was running.")


def _give_up(playback: Playback, now: datetime, problem: str) -> None:
    logger.error("playback_given_up", playback=playback.id, attempts=playback.attempts)
    playback.state, playback.finished_at, playback.problem = PlaybackState.FAILED, now, problem


def _find_sensor(session: Session, episode: EpisodeResult) -> str | None:
    """Return the digest of the sensor of an episode; equal submissions have the same one."""
    found = select(SubmissionFile.sha256).join(Submission, Submission.id == SubmissionFile.submission_id)
    of_episode = (Submission.digest == episode.submission_digest, Submission.track == episode.track)
    return session.scalar(found.where(*of_episode, SubmissionFile.role == FileRole.SENSOR).limit(1))


def _end(session: Session, lease: PlaybackLease, **values: Any) -> None:
    _change_held(session, lease, lease_expires_at=None, finished_at=datetime.now(UTC), **values)


def _change_held(session: Session, lease: PlaybackLease, **values: Any) -> None:
    held = (
        Playback.id == lease.playback_id,
        Playback.token == lease.token,
        Playback.state == PlaybackState.RUNNING,
    )
    changed = session.scalar(
        update(Playback)
        .where(*held)
        .values(**values)
        .returning(Playback.id)
        .execution_options(synchronize_session=False)
    )
    if changed is None:
        raise LeaseLost(f"Playback {lease.playback_id} is no longer held under token {lease.token}.")
