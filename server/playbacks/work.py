"""The work on playbacks: what a worker needs to make one, how it ends, and what becomes of old and lost ones."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import structlog
from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family
from vitac.evaluator.episodes.records import EpisodeRecord
from vitac.evaluator.tracks.registry import find_evaluator

from ..competitions.sealing import derive_list_seed
from ..database.clock import read_clock
from ..database.engine import Database
from ..database.models import EpisodeResult, Playback, Submission, SubmissionFile, Work, Worker
from ..database.states import OPEN_WORK_STATES, FileRole, WorkerState, WorkState
from ..errors import not_found
from ..queue.work import Claim, end, lock_held, name_requirement
from ..queue.work import renew as renew_claim
from ..settings import Settings
from ..storage.blobs import BlobStore, StoredFileLost

logger = structlog.get_logger(__name__)

UNMADE_KEPT = timedelta(hours=1)
"""How long a playback waits for a worker that can make it, after it was asked for and after the last such worker."""

_FILES = (Playback.scene_sha256, Playback.cameras_sha256, Playback.still_sha256, Playback.film_sha256)


@dataclass(frozen=True, kw_only=True)
class PlaybackLease(Claim):
    """The right to make one playback, and all that is needed for it.

    Attributes:
        list_seed: of the sealed list that was played; None for the public one.
        sensor_sha256: of the sensor that was played with; None for the challenge's.
    """

    track: str
    record: EpisodeRecord
    list_seed: int | None = None
    sensor_sha256: str | None = None


def begin(session: Session, claim: Claim) -> PlaybackLease:
    """Return the lease on a claimed playback."""
    episode = session.get_one(Playback, claim.work_id).episode
    return PlaybackLease(
        **vars(claim),
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
    renew_claim(session, lease, lease_s)
    _change(session, lease, env_steps_played=env_steps_played)


def end_made(session: Session, lease: PlaybackLease, digests: Mapping[str, str]) -> None:
    """Mark the playback as made.

    Args:
        session: of the transaction.
        lease: on the playback.
        digests: SHA-256 of the stored files by column.

    Raises:
        LeaseLost: it is no longer ours.
    """
    lock_held(session, lease)
    _change(session, lease, env_steps_played=lease.record.env_steps, **digests)
    end(session, lease, WorkState.DONE)


def give_up_unmade(session: Session) -> None:
    """Give up playbacks that no worker can make: each counts against the limits of who asked for it as it waits."""
    now = read_clock(session)
    oldest = now - UNMADE_KEPT
    there = (Worker.heartbeat_at > oldest, Worker.state != WorkerState.REFUSING)
    rows = session.execute(select(Worker.evaluator_version, Worker.families).where(*there)).all()
    abilities = {name_requirement(version, family) for version, families in rows for family in map(Family, families)}
    overdue = (Playback.state == WorkState.QUEUED, Playback.asked_at < oldest)
    for playback in session.scalars(select(Playback).where(*overdue).with_for_update(of=Work, skip_locked=True)):
        family = Family(playback.requires.removeprefix(f"{playback.evaluator_version} "))
        if name_requirement(find_evaluator(playback.evaluator_version), family) not in abilities:
            logger.error("playback_given_up", playback=playback.id)
            playback.state, playback.finished_at = WorkState.FAILED, now
            playback.problem = "No worker that can make it was running."


def remove_old(session: Session, settings: Settings) -> None:
    """Remove playbacks that were asked for long ago; they are made again when somebody wants to see them."""
    oldest = read_clock(session) - timedelta(days=settings.playbacks_kept_days)
    remove(session, Playback.asked_at < oldest, Playback.state.not_in(OPEN_WORK_STATES))


def remove(session: Session, *conditions: Any) -> None:
    """Remove playbacks on conditions."""
    session.execute(delete(Work).where(Work.id.in_(select(Playback.id).where(*conditions))))


def stored_digests(session: Session) -> set[str]:
    """Return the SHA-256 of all files of playbacks."""
    rows = session.execute(select(*_FILES)).all()
    return {digest for row in rows for digest in row if digest is not None}


def read_file(database: Database, blobs: BlobStore, digest: str) -> bytes:
    """Return a file; where it is lost, its playback is removed, so that it is made again when somebody asks.

    Raises:
        ServiceError: it is lost or the store cannot be read.
    """
    try:
        return blobs.read(digest)
    except StoredFileLost as error:
        with database.transaction() as session:
            for column in _FILES:
                remove(session, column == digest)
        raise not_found("playback file", digest) from error


def _change(session: Session, lease: PlaybackLease, **values: Any) -> None:
    """Change columns of the playback, whose row in the queue is locked."""
    changed = update(Playback).where(Playback.id == lease.work_id).values(**values)
    session.execute(changed.execution_options(synchronize_session=False))


def _find_sensor(session: Session, episode: EpisodeResult) -> str | None:
    """Return the digest of the sensor of an episode; equal submissions have the same one."""
    query = select(SubmissionFile.sha256).join(Submission, Submission.id == SubmissionFile.submission_id)
    of_episode = (Submission.digest == episode.submission_digest, Submission.track == episode.track)
    return session.scalar(query.where(*of_episode, SubmissionFile.role == FileRole.SENSOR).limit(1))
