"""Turns a 2025 text log into recordings of our own episodes; called by the server at an upload and by the shards.

The log's list must be ours. What it does not contain is drawn from the episode's seed: the noise of the markers and,
for the lock, the position of the key between the sensors.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...tracks import Task, list_tracks, load_track
from ..checks import out_of_bounds
from ..findings import Impossibility, ImpossibleReason
from ..recordings import Recording
from . import Script, TextEpisode, TextLog
from .checks import hole_top
from .scripts import is_printed


def track_and_task_names(script: Script) -> tuple[str, str]:
    """Return our names of a script's track and task, whether or not we have them."""
    for track in map(load_track, list_tracks()):
        for task in track.tasks.values():
            if (track.folder, task.name_2025) == (script.track, script.task):
                return track.name, task.name
    return script.track.lower(), script.task.replace("_", "-")


def explain_not_resimulated(log: TextLog, script: Script, task: Task) -> Impossibility | None:
    """Return why a text log cannot be re-simulated as a whole evaluation of our task; None if it can."""
    starts = script.starts(hole_top(log, script))
    if [(start.part, start.listed_offset) for start in starts] != [(e.shape, e.offset) for e in task.episodes]:
        return Impossibility(
            reason=ImpossibleReason.OTHER_EVALUATION, message=f"The list of {task.name} is not the published one."
        )
    for number, episode in enumerate(log.episodes, start=1):
        shown = starts[number - 1].offset if number <= len(starts) else ()
        impossibility = _explain_episode_not_resimulated(number, episode, task, shown, must_show=script.logs_offsets)
        if impossibility:
            return impossibility
    if len(log.episodes) < len(task.episodes):
        first = len(log.episodes) + 1
        message = f"Expected {len(task.episodes)} tests, got {len(log.episodes)}; the first missing one is {first}."
        return Impossibility(reason=ImpossibleReason.EPISODE_MISSING, message=message, episode=first)
    return None


def text_log_recordings(log: TextLog, script: Script, task: Task) -> Iterator[Recording]:
    """Yield the recordings of a text log that can be re-simulated, in the order of the list, from where it started."""
    starts = script.starts(hole_top(log, script))
    for episode, listed, start in zip(log.episodes, task.episodes, starts, strict=True):
        played = replace(listed, offset=start.true_offset)
        yield Recording(episode=played, actions=_actions(episode, task), infos=(), success=episode.success is True)


def _explain_episode_not_resimulated(
    number: int, episode: TextEpisode, task: Task, shown: tuple[float, ...], *, must_show: bool
) -> Impossibility | None:
    place = f"Test {number}"

    def impossible(reason: ImpossibleReason, message: str) -> Impossibility:
        return Impossibility(reason=reason, message=message, episode=number)

    if number > len(task.episodes):
        return impossible(ImpossibleReason.NOT_IN_LIST, f"{place} is not in the list of {len(task.episodes)} tests.")
    if episode.number != number:
        return impossible(
            ImpossibleReason.EPISODE_MISSING, f"{place}: expected its number in the log, got {episode.number}."
        )
    if episode.initial_offset is None and must_show:
        return impossible(ImpossibleReason.OTHER_START, f"{place}: expected the start {shown}, got none.")
    if episode.initial_offset is not None and not is_printed(episode.initial_offset, shown):
        message = f"{place}: expected the start {shown}, got {episode.initial_offset!s:.80}."
        return impossible(ImpossibleReason.OTHER_START, message)
    if len(episode.steps) > task.max_steps:
        message = f"{place} has {len(episode.steps)} env steps, expected at most {task.max_steps}."
        return impossible(ImpossibleReason.TOO_MANY_STEPS, message)
    if not episode.steps or any(len(step.action) != len(task.actions) for step in episode.steps):
        names = ", ".join(row.name for row in task.actions)
        return impossible(
            ImpossibleReason.WRONG_ACTION, f"{place}: expected actions [{names}], got none or one of another size."
        )
    outside = out_of_bounds(task, _actions(episode, task))
    return impossible(ImpossibleReason.WRONG_ACTION, f"{place} {outside}") if outside else None


def _actions(episode: TextEpisode, task: Task) -> NDArray[np.float32]:
    """Return the actions as printed, which may lack their last bits; shape [env steps, action size]."""
    with np.errstate(over="ignore"):  # A number too large for float32 becomes infinite, and so out of bounds.
        return np.array([step.action for step in episode.steps]).astype(np.float32).reshape(-1, len(task.actions))
