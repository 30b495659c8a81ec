"""Recorded actions for re-simulation, whichever kind of file they are from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue
from vitac.errors import VitacError

from ..episodes.records import EpisodeRecord
from ..tracks import Episode, Task

_LARGEST_FLOAT32 = float(np.finfo(np.float32).max)


class RecordingRejected(VitacError):
    """A file of recorded actions cannot be used; the message names the line and the reason."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """The recorded actions of one episode, shape [env steps, action size], and the info of each env step, if any.

    `success` is None where the file does not say how the episode ended.
    """

    episode: Episode
    actions: NDArray[np.float32]
    infos: tuple[dict[str, JsonValue], ...]
    success: bool | None


def make_recording(record: EpisodeRecord, task: Task) -> Recording:
    """Return one of our records as a recording.

    Raises:
        RecordingRejected: it is of another task, or its actions have the wrong size.
    """
    place = f"Episode {record.episode}"
    if record.task != task.name:
        raise RecordingRejected(f"{place} is of task {record.task!r}, expected {task.name!r}.")
    return Recording(
        episode=find_recorded_episode(task, record.episode, record.shape, record.initial_offset, place),
        actions=recorded_actions(task, record.actions.to_array().tolist(), place),
        infos=record.infos,
        success=record.success,
    )


def find_recorded_episode(task: Task, number: int, shape: str, offset: tuple[float, ...], place: str) -> Episode:
    """Return the start as recorded; it may differ from the one in the task's list.

    Raises:
        RecordingRejected: the task has no such shape, or starts with another number of values.
    """
    example = task.episodes[0]
    if shape not in task.episode_list.shapes or len(offset) != len(example.offset):
        expected = f"one of {', '.join(task.episode_list.shapes)} and {len(example.offset)} numbers"
        raise RecordingRejected(f"{place}: expected a start with {expected}, got {shape!r} at {offset}.")
    return Episode(
        number=number,
        shape=shape,
        offset=offset,
        offset_option=example.offset_option,
        list_seed=example.list_seed,
    )


def recorded_actions(task: Task, rows: Sequence[Sequence[float]], place: str) -> NDArray[np.float32]:
    """Return recorded actions, shape [env steps, action size].

    Raises:
        RecordingRejected: they have another size or are no float32.
    """
    size = len(task.actions)
    if all(len(row) == size and all(abs(value) <= _LARGEST_FLOAT32 for value in row) for row in rows):
        return np.array(rows, dtype=np.float32).reshape(len(rows), size)
    names = ", ".join(row.name for row in task.actions)
    raise RecordingRejected(f"{place}: expected actions [{names}] in the range of float32.")
