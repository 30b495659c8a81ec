"""Reads recorded actions for re-simulation: our own logs and records, and 2025 text logs converted to JSON lines."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, JsonValue, PositiveInt
from vitac.envs.errors import VitacError

from ..episodes.records import EpisodeRecord
from ..strict_model import DocumentRejected, validate
from ..tracks import Episode, Task
from .log import MAX_LINE_BYTES, LogReader, is_log
from .packing import open_log
from .text_2025.scripts import all_scripts

_LARGEST_FLOAT32 = float(np.finfo(np.float32).max)


class RecordingRejected(VitacError):
    """A file of recorded actions cannot be used; the message names the line and the reason."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """The recorded actions of one episode, shape [env steps, action size], and the info of each env step, if any."""

    episode: Episode
    actions: NDArray[np.float32]
    infos: tuple[dict[str, JsonValue], ...]
    success: bool


class _Line(BaseModel):
    """Part of a converted 2025 line; unknown keys are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class _StepOf2025(_Line):
    action: tuple[float, ...]
    surface_diff_m: tuple[float, ...] | None = None
    peg_relative_z_mm: tuple[float, ...] | None = None


class _EpisodeOf2025(_Line):
    episode: PositiveInt
    task: str
    shape: str
    initial_offset: tuple[float, ...]
    steps: tuple[_StepOf2025, ...]
    result: str


def read_recordings(path: Path, task: Task) -> Iterator[Recording]:
    """Yield the recorded episodes of a file.

    Args:
        path: one of our logs; or JSON lines, each one of our episode records or a converted 2025 episode.
        task: task that the recordings must be of.

    Raises:
        RecordingRejected: a line cannot be read or is of another task.
        LogRejected: one of our logs is truncated or altered.
    """
    if is_log(path):
        with open_log(path) as stream:
            yield from (recording_of(record, task) for record in LogReader(stream).records())
        return
    with open_log(path) as stream:
        lines = enumerate(iter(lambda: stream.readline(MAX_LINE_BYTES + 1), b""), start=1)
        yield from (_recording_in(line, number, task) for number, line in lines)


def recording_of(record: EpisodeRecord, task: Task) -> Recording:
    """Return one of our records as a recording.

    Raises:
        RecordingRejected: it is of another task, or its actions have the wrong size.
    """
    place = f"Episode {record.episode}"
    if record.task != task.name:
        raise RecordingRejected(f"{place} is of task {record.task!r}, expected {task.name!r}.")
    return Recording(
        episode=_episode(task, record.episode, record.shape, record.initial_offset, place),
        actions=_actions(task, record.actions.to_array().tolist(), place),
        infos=record.infos,
        success=record.success,
    )


def _recording_in(line: bytes, number: int, task: Task) -> Recording:
    place = f"Line {number}"
    try:
        content = json.loads(line)
        if isinstance(content, dict) and "state_hashes" in content:
            return recording_of(validate(EpisodeRecord, content, place), task)
        return _recording_of_2025(validate(_EpisodeOf2025, content, place), place, task)
    except (ValueError, RecursionError) as error:
        raise RecordingRejected(f"{place} is not JSON: {error!s:.120}.") from error
    except DocumentRejected as error:
        raise RecordingRejected(str(error)) from error


def _recording_of_2025(content: _EpisodeOf2025, place: str, task: Task) -> Recording:
    if content.task != task.name_2025:
        raise RecordingRejected(f"{place} is of task {content.task!r}, expected {task.name!r}.")
    shape, offset = content.shape, content.initial_offset
    start = next(
        (s.find_start(shape, offset) for s in all_scripts() if s.hole_tops_mm and s.task == content.task), None
    )
    if start is not None:  # The log shows it relative to the hole, in the books of its era.
        shape, offset = start.part, start.true_offset
    return Recording(
        episode=_episode(task, content.episode, shape, offset, place),
        actions=_actions(task, [step.action for step in content.steps], place),
        infos=tuple(step.model_dump(mode="json", exclude={"action"}, exclude_none=True) for step in content.steps),
        success=content.result == "SUCCESS",
    )


def _episode(task: Task, number: int, shape: str, offset: tuple[float, ...], place: str) -> Episode:
    """Return the start as recorded; it may differ from the one in the task's list."""
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


def _actions(task: Task, rows: Sequence[Sequence[float]], place: str) -> NDArray[np.float32]:
    size = len(task.actions)
    if all(len(row) == size and all(abs(value) <= _LARGEST_FLOAT32 for value in row) for row in rows):
        return np.array(rows, dtype=np.float32).reshape(len(rows), size)
    names = ", ".join(row.name for row in task.actions)
    raise RecordingRejected(f"{place}: expected actions [{names}] in the range of float32.")
