"""Asking for an episode's playback, and the sentences that tell how it went."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta
from enum import StrEnum
from itertools import pairwise
from typing import Any, Final
from uuid import UUID

import numpy as np
from sqlalchemy import ColumnElement, func, select, tuple_
from sqlalchemy.orm import Session
from vitac.envs.drawing.drawable import NotDrawable, find_perspective
from vitac.envs.scene.perspective import Perspective
from vitac.envs.tasks.definition import LARGEST_SURFACE_DIFF_M, Family
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord, canonical_json
from vitac.evaluator.playback import FORMAT, NotPlayable, require_playable
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
from ..views.comparisons import PlaybackView, ShownEpisodeView, StoryMomentView
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


TOUCH_MM: Final = 0.2
"""Motion of a gel's surface since the grasp from which on the held part counts as touching something."""
STILL_MM: Final = 0.05
"""By less than this the decisive height must change in an env step for the held part to count as stuck."""
LEAST_FORCE_N: Final = 0.05
"""A smaller force on the held part is not worth words: it touched nothing."""
_SIDES = ("left", "right")
_NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")
_ENDS = {
    EpisodeOutcome.FORCE: "too much force",
    EpisodeOutcome.TACTILE: "a gel has moved too far",
    EpisodeOutcome.ERROR: "out of range",
    EpisodeOutcome.STEPS: "no env steps are left",
}
"""What ended a failed episode, in a few words."""


class Mark(StrEnum):
    """What a moment on the time line marks."""

    TOUCH = "touch"  # the held part touches something
    SLIP = "slip"  # a gel springs back by more than half: the held part slips, or comes free
    STUCK = "stuck"  # from here to the end the held part comes no nearer to its goal
    SOLVED = "solved"
    LIMIT = "limit"  # the flag that ended the episode


@dataclass(frozen=True, kw_only=True)
class Story:
    """What happened in an episode."""

    sentence: str
    moments: tuple[StoryMomentView, ...]


def tell_story(record: EpisodeRecord, env_id: str) -> Story:
    """Return what happened in an episode; only its end if nothing was felt or can be drawn."""
    ending = Story(sentence=record.outcome.sentence, moments=())
    if not record.infos or "surface_diff_m" not in record.infos[0]:
        return ending
    try:
        perspective = find_perspective(env_id)
    except NotDrawable:
        return ending
    course = _Course(perspective, record.infos)
    return Story(sentence=_sentence(record, course), moments=_moments(record.outcome, course))


class _Course:
    """The numbers of an episode after each env step.

    Attributes:
        motions_mm: mean motion of the left and right gel's surface since the grasp, shape [n, 2].
        missing_mm: by how much the worst of the deciding heights misses its goal, shape [n]; 0 where none does.
    """

    def __init__(self, perspective: Perspective, infos: Sequence[dict[str, Any]]) -> None:
        self.perspective = perspective
        self.infos = [{key: np.asarray(value) for key, value in info.items()} for info in infos]
        self.motions_mm = np.array([1e3 * info["surface_diff_m"] for info in self.infos])
        progress = perspective.progress
        sign = 1.0 if progress.goal_is_below else -1.0
        missing = [(sign * (progress.heights_mm(info) - progress.goal_mm)).max() for info in self.infos]
        self.missing_mm = np.maximum(missing, 0.0)

    def position(self, env_step: int) -> str:
        """Return where the held part is after an env step, in words."""
        return self.perspective.position(self.infos[env_step - 1])

    @property
    def touched(self) -> int | None:
        """The first env step after which the held part touches something."""
        return next((step for step, motion in enumerate(self.motions_mm, 1) if motion.max() > TOUCH_MM), None)

    @property
    def slipped(self) -> list[int]:
        """Env steps in which a gel springs back by more than half."""
        largest = self.motions_mm.max(axis=1)
        return [
            step
            for step, (before, after) in enumerate(pairwise(largest), 2)
            if before > 2 * TOUCH_MM and after < 0.5 * before
        ]

    @property
    def stuck(self) -> int | None:
        """The first env step since which the held part has come no nearer to its goal, over two steps or more."""
        nearer = np.flatnonzero(self.missing_mm[:-1] - self.missing_mm[1:] > STILL_MM)
        last = int(nearer[-1]) + 2 if nearer.size else 1
        return last if len(self.missing_mm) - last >= 2 and self.missing_mm[-1] > 0 else None


def _sentence(record: EpisodeRecord, course: _Course) -> str:
    """Return what happened, and then its numbers."""
    outcome, peak_n = record.outcome, record.forces.part.peak_n if record.forces else None
    held, after = course.perspective.held_name, f"after {_count_moves(len(course.infos))}"
    side = int(course.motions_mm[-1].argmax())
    if outcome is EpisodeOutcome.SUCCESS:
        return f"The {held} {course.perspective.arrival} {after}. {_describe_success(course, peak_n)}"
    if outcome is EpisodeOutcome.FORCE and record.forces:
        return (
            f"The {held} was pressed too hard {after}: the force on it reached {peak_n:.1f} N "
            f"(limit {record.forces.over_force_n:g} N), {_describe_position(course)}."
        )
    if outcome is EpisodeOutcome.TACTILE:
        return (
            f"The {_SIDES[side]} gel was pushed too far {after}: its surface had moved by "
            f"{course.motions_mm[-1, side]:.2f} mm (limit {1e3 * LARGEST_SURFACE_DIFF_M:g} mm), "
            f"{_describe_position(course)}."
        )
    if outcome is EpisodeOutcome.ERROR:
        return f"The gripper or the {held} left its range {after}, {_describe_position(course)}."
    if outcome is EpisodeOutcome.STEPS:
        moves = _count_moves(len(course.infos))
        return f"The {held} did not get there: all {moves} were used up, {_describe_position(course)}."
    return outcome.sentence


def _describe_success(course: _Course, peak_n: float | None) -> str:
    """Return the numbers of a solved episode as a sentence."""
    touch = (
        f"It touched at env step {course.touched} ({course.position(course.touched)}) and" if course.touched else "It"
    )
    force = f"; the largest force on it was {peak_n:.1f} N" if peak_n and peak_n >= LEAST_FORCE_N else ""
    return (
        f"{touch} ended at {course.position(len(course.infos))}; no gel’s surface moved by more than "
        f"{course.motions_mm.max():.2f} mm{force}."
    )


def _count_moves(number: int) -> str:
    """Return a number of env steps as people say it: "one move", "six moves", "27 moves"."""
    words = _NUMBERS[number] if number < len(_NUMBERS) else str(number)
    return f"{words} {'move' if number == 1 else 'moves'}"


def _describe_position(course: _Course) -> str:
    """Return where the held part was at the end, as the end of a sentence."""
    missing = course.missing_mm[-1]
    goal = f"{missing:.1f} mm short of its goal" if missing > 0 else "its height reached"
    return f"with the {course.perspective.held_name} {goal} ({course.position(len(course.infos))})"


def _moments(outcome: EpisodeOutcome, course: _Course) -> tuple[StoryMomentView, ...]:
    held, last = course.perspective.held_name, len(course.infos)
    moments = [StoryMomentView(env_step=step, mark=Mark.SLIP, text="a gel springs back") for step in course.slipped]
    if course.touched:
        moments.append(StoryMomentView(env_step=course.touched, mark=Mark.TOUCH, text=f"the {held} touches"))
    if outcome is EpisodeOutcome.SUCCESS:
        moments.append(StoryMomentView(env_step=last, mark=Mark.SOLVED, text="solved"))
    else:
        if course.stuck:
            moments.append(StoryMomentView(env_step=course.stuck, mark=Mark.STUCK, text=f"the {held} comes no nearer"))
        moments.append(
            StoryMomentView(env_step=last, mark=Mark.LIMIT, text=_ENDS.get(outcome, outcome.value.replace("_", " ")))
        )
    return tuple(sorted(moments, key=lambda moment: moment.env_step))
