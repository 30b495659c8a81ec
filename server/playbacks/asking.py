"""Asks for the playback of an episode; called by the pages.

A playback is computed once, whoever asks for it, and goes before evaluations within its share of the workers' time.
What one team may have in the queue and ask for in an hour is limited, so that nobody can keep the others waiting.
Visitors may ask for those of public submissions and have one such limit together.
"""

import hashlib
from datetime import timedelta
from enum import StrEnum
from uuid import UUID

from sqlalchemy import ColumnElement, func, select, tuple_
from sqlalchemy.orm import Session
from vitac.envs.tasks.definition import Family
from vitac.evaluator.episodes.records import EpisodeRecord, canonical_json
from vitac.evaluator.playback.making import FORMAT, NotPlayable, require_playable
from vitac.evaluator.tracks import load_track
from vitac.evaluator.tracks.registry import find_version

from ..accounts.shown_names import ShownNames
from ..database.clock import read_clock
from ..database.locks import AdvisoryLock, wait_for_turn
from ..database.models import EpisodeResult, Playback, Work
from ..database.states import OPEN_WORK_STATES, WorkKind, WorkState
from ..errors import ProblemCode, ServiceError, not_found
from ..evaluations.episode_store import find_shown_key
from ..evaluations.history import newest_evaluation
from ..leaderboards.public_pages import readable
from ..principals import VISITOR, Principal
from ..queue.work import name_requirement, waiting
from ..queue.workers import fleet
from ..settings import Settings
from ..tracks import find_playback_family
from ..views.comparisons import PlaybackView, ShownEpisodeView
from .story import tell_story
from .work import remove


class PlaybackFile(StrEnum):
    """What a page plays or shows of a playback."""

    SCENE = "scene"
    """What moves, and what is plotted; compressed with gzip."""
    CAMERAS = "cameras"
    """What the camera rig saw; compressed with gzip."""
    STILL = "still"
    """The end of the episode as the player first shows its scene, or the last picture of the film; WebP."""
    FILM = "film"
    """Pictures of an episode of ManiSkill one after the other, an animated WebP."""


NOBODY_DRAWS = "no running worker can draw ManiSkill’s environments, which takes its packages and a Vulkan driver"
"""Why nobody makes a film of ManiSkill."""

FAILED_KEPT = timedelta(hours=1)
"""How long a failed playback is not tried again."""


def find_episode(
    session: Session, by: Principal, submission_id: UUID, task: str, number: int, *, practice: bool = False
) -> EpisodeResult:
    """Return a finished episode of the newest evaluation of a submission.

    Args:
        session: of the transaction.
        by: who asks.
        submission_id: of the submission.
        task: name.
        number: of the episode.
        practice: on the public list that was played beside a sealed one, instead of on that of the result.

    Raises:
        ServiceError: there is none that the principal may see.
    """
    submission = readable(session, by, submission_id)
    evaluation = newest_evaluation(session, submission)
    key = find_shown_key(session, by, evaluation, practice=practice)
    wanted = (EpisodeResult.task == task, EpisodeResult.episode == number)
    episode = session.scalar(select(EpisodeResult).where(*key.conditions(), *wanted)) if key else None
    if episode is None:
        raise not_found("episode", f"{number} of {task} of submission {submission_id}")
    return episode


def is_public(session: Session, submission_id: UUID, task: str, number: int, *, practice: bool = False) -> bool:
    """Return whether everybody may see an episode; the arguments are those of `find_episode`."""
    try:
        find_episode(session, VISITOR, submission_id, task, number, practice=practice)
    except ServiceError:
        return False
    return True


def find_playback(session: Session, episode: EpisodeResult) -> Playback | None:
    """Return the playback of an episode; None where nobody has asked for it, or in another format."""
    return session.scalar(select(Playback).where(Playback.key == playback_key(episode)))


def find_digest(session: Session, episode: EpisodeResult, file: PlaybackFile) -> str:
    """Return the SHA-256 of a file of an episode's playback.

    Raises:
        ServiceError: there is none.
    """
    playback = find_playback(session, episode)
    digest = None if playback is None else getattr(playback, f"{file.value}_sha256")
    if digest is None:
        raise not_found("playback file", file.value)
    return str(digest)


def ask(session: Session, settings: Settings, by: Principal, episode: EpisodeResult) -> Playback:
    """Return the playback of an episode; one that is not there is queued.

    Raises:
        ServiceError: too_many_requests, with how many are possible; invalid_request where no worker can make it.
    """
    try:
        require_playable(load_track(episode.track).task(episode.task))
    except NotPlayable as error:
        raise ServiceError(ProblemCode.INVALID_REQUEST, str(error)) from error
    asked_by = requester(by)
    wait_for_turn(session, AdvisoryLock.PLAYBACK_OF_REQUESTER, asked_by)
    # The second of two who ask at the same time waits here for the first one.
    wait_for_turn(session, AdvisoryLock.PLAYBACK_OF_EPISODE, playback_key(episode))
    existing = find_playback(session, episode)
    if existing is not None and not _may_retry(session, existing):
        return existing
    _require_somebody_who_draws(session, settings, episode)
    if not by.organizes_any:
        _refuse_one_more(session, settings, asked_by)
    if existing is not None:
        remove(session, Playback.id == existing.id)
    version = find_version(episode.track)
    requires = name_requirement(version, find_playback_family(episode.track, episode.task))
    playback = Playback(
        key=playback_key(episode),
        episode_id=episode.id,
        evaluator_version=version,
        asked_at=read_clock(session),
        **waiting(session, WorkKind.PLAYBACK, owner=asked_by, requires=requires),
    )
    session.add(playback)
    session.flush()
    return playback


def playback_key(episode: EpisodeResult) -> str:
    """Return the SHA-256 [hex] of all that a playback is made from."""
    content = {
        "format": FORMAT,
        "evaluator_version": find_version(episode.track),
        "track": episode.track,
        "record_digest": episode.record_digest,
    }
    if load_track(episode.track).has_sensor:  # Blind runs with one gel have the same records whatever its markers are.
        content["submission_digest"] = episode.submission_digest
    return hashlib.sha256(canonical_json(content)).hexdigest()


def requester(by: Principal) -> str:
    """Return whose limits count what somebody asks for."""
    return f"team:{by.team_id}" if by.team_id is not None else (by.role or "visitor")


def shown_episode(
    session: Session,
    settings: Settings,
    by: Principal,
    submission_id: UUID,
    task: str,
    number: int,
    *,
    practice: bool = False,
) -> ShownEpisodeView:
    """Return a finished episode as its page shows it; the arguments are those of `find_episode`.

    Raises:
        ServiceError: there is none that the principal may see.
    """
    submission = readable(session, by, submission_id)
    episode = find_episode(session, by, submission_id, task, number, practice=practice)
    record = EpisodeRecord.model_validate(episode.record)
    playback = find_playback(session, episode)
    story = tell_story(record, load_track(episode.track).task(task).env_id)
    return ShownEpisodeView.from_row(
        record,
        submission_name=submission.name,
        team=ShownNames.read(session, by).show_name(submission.team),
        track=episode.track,
        task=task,
        episode=number,
        story=story.sentence,
        moments=story.moments,
        evaluator_version=episode.evaluator_version,
        record_digest=episode.record_digest,
        playback=None if playback is None else playback_view(session, settings, playback),
    )


def playback_view(session: Session, settings: Settings, playback: Playback) -> PlaybackView:
    """Return a playback as the pages show it."""
    is_open = playback.state in OPEN_WORK_STATES
    family = find_playback_family(playback.episode.track, playback.episode.task)
    alive = fleet(session, settings).alive(playback.evaluator_version, family).alive if is_open else None
    return PlaybackView.from_row(
        playback,
        env_steps=playback.episode.env_steps,
        waits_for=_count_before(session, playback) if playback.state is WorkState.QUEUED else 0,
        family=family,
        workers=alive,
        has_cameras=playback.cameras_sha256 is not None,
        has_still=playback.still_sha256 is not None,
    )


def _may_retry(session: Session, playback: Playback) -> bool:
    failed_at = playback.finished_at if playback.state is WorkState.FAILED else None
    return failed_at is not None and failed_at < read_clock(session) - FAILED_KEPT


def _require_somebody_who_draws(session: Session, settings: Settings, episode: EpisodeResult) -> None:
    """Refuse a film that no running worker can make; most machines never can, and it would count as waiting."""
    family = find_playback_family(episode.track, episode.task)
    if family is not Family.TACTILE and not fleet(session, settings).alive(find_version(episode.track), family).alive:
        raise ServiceError(ProblemCode.INVALID_REQUEST, f"There is no playback of this episode, as {NOBODY_DRAWS}.")


def _refuse_one_more(session: Session, settings: Settings, asked_by: str) -> None:
    within_hour = Playback.asked_at > read_clock(session) - timedelta(hours=1)
    limits: tuple[tuple[int, ColumnElement[bool], str], ...] = (
        (settings.playbacks_at_once, Playback.state.in_(OPEN_WORK_STATES), "playbacks that wait or are being made"),
        (settings.playbacks_per_hour, within_hour, "new playbacks in an hour"),
    )
    for limit, condition, what in limits:
        asked = select(func.count()).select_from(Playback).where(Playback.owner == asked_by, condition)
        count = session.scalars(asked).one()
        if count >= limit:
            raise ServiceError(
                ProblemCode.TOO_MANY_REQUESTS, f"At most {limit} {what} are possible, and there are {count}; try later."
            )


def _count_before(session: Session, playback: Playback) -> int:
    """Return how many playbacks come before one that waits."""
    earlier = tuple_(Work.turn, Work.id) < tuple_(playback.turn, playback.id)
    waits = (Work.kind == WorkKind.PLAYBACK, Work.state == WorkState.QUEUED)
    return session.scalars(select(func.count()).select_from(Work).where(*waits, earlier)).one()
