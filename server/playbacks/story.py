"""What happened in an episode, in one sentence and as moments on its time line, from its record alone.

Pages show it above the player; nothing is simulated for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import Any, Final

import numpy as np
from vitac.envs.drawing.drawable import NotDrawable, find_perspective
from vitac.envs.scene.perspective import Perspective
from vitac.envs.tasks.definition import LARGEST_SURFACE_DIFF_M
from vitac.evaluator.episodes.records import EpisodeOutcome, EpisodeRecord

from ..views.comparisons import StoryMomentView

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
