"""Recorded actions in our physics, read from whichever kind of file: the report of `vitac resimulate`."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from pydantic import BaseModel, ConfigDict, JsonValue, PositiveInt, SerializerFunctionWrapHandler, model_serializer

from ..episodes.episode import Environment
from ..episodes.records import EpisodeOutcome, EpisodeRecord
from ..episodes.replay import Resimulated, resimulate
from ..strict_model import DocumentRejected, StrictModel, validate
from ..tracks import Task
from .log import MAX_LINE_BYTES, LogReader, is_log
from .packing import open_log
from .recordings import Recording, RecordingRejected, find_recorded_episode, make_recording, recorded_actions
from .text_2025 import TextLogRejected, is_text_log, read_text_log, summarize, to_json_lines
from .text_2025.scripts import all_scripts

_FLAGS = ("is_success", "force_too_large", "tactile_movement_too_large", "error_too_large")


class ReportedStep(StrictModel):
    """One env step. In JSON the task's own measures [mm] stand beside `n`; it omits what the info does not have."""

    n: int
    measures: dict[str, tuple[float, ...]]
    is_success: bool | None = None
    force_too_large: bool | None = None
    tactile_movement_too_large: bool | None = None
    error_too_large: bool | None = None

    @model_serializer(mode="wrap")
    def _flat(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        written = write(self)
        return {"n": written.pop("n"), **written.pop("measures"), **written}


class ReportedEpisode(StrictModel):
    """One episode; `end_step` and `end_reason` are None where nothing ended it within the recorded actions."""

    episode: int
    steps: tuple[ReportedStep, ...]
    success: bool
    end_step: int | None
    end_reason: EpisodeOutcome | None


class Report(StrictModel):
    """All episodes of a recording."""

    episodes: tuple[ReportedEpisode, ...]
    solver_version: str
    ipc_steps: int
    cpu_s_per_ipc_step: float


def resimulate_all(
    env: Environment, task: Task, recordings: Iterable[Recording]
) -> Iterator[tuple[Recording, ReportedEpisode]]:
    """Re-simulate the recordings one at a time; yield each with its report.

    Args:
        env: environment of the task.
        task: what was played.
        recordings: actions of its episodes.
    """
    for recording in recordings:
        yield recording, _episode(task, recording, resimulate(env, recording.episode, recording.actions))


def report(env: Environment, episodes: Iterable[ReportedEpisode]) -> Report:
    """Return the report on all episodes that this environment has run since it was made."""
    return Report(
        episodes=tuple(episodes),
        solver_version=env.solver_version,
        ipc_steps=env.ipc_steps,
        cpu_s_per_ipc_step=env.physics_cpu_s / env.ipc_steps if env.ipc_steps else 0.0,
    )


def reported_step(task: Task, number: int, info: Mapping[str, JsonValue]) -> ReportedStep:
    """Return what a report holds of the info of one env step, ours or recorded."""
    shown = [measure for measure in task.definition.measures if all(key in info for key in measure.needs)]
    flags: dict[str, Any] = {key: info[key] for key in _FLAGS if key in info}
    return ReportedStep(n=number, measures={measure.name: measure.read(info) for measure in shown}, **flags)


def _episode(task: Task, recording: Recording, played: Resimulated) -> ReportedEpisode:
    return ReportedEpisode(
        episode=recording.episode.number,
        steps=tuple(reported_step(task, number, info) for number, info in enumerate(played.infos, start=1)),
        success=played.outcome is EpisodeOutcome.SUCCESS,
        end_step=played.end_step,
        end_reason=played.outcome,
    )


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
    result: str | None


def read_recordings(
    path: Path, task: Task, on_problems: Callable[[int], object] = lambda _: None
) -> Iterator[Recording]:
    """Yield the recorded episodes of a file.

    Args:
        path: one of our logs; a 2025 text log; or JSON lines, each one of our episode records or a converted 2025
            episode. Any of them may be gzipped.
        task: task that the recordings must be of.
        on_problems: is given the number of problems of a text log, before the first recording, if it has any.

    Raises:
        RecordingRejected: a line cannot be read or is of another task.
        LogRejected: one of our logs is truncated or altered.
        TextLogRejected: a text log cannot be read, is of no script of 2025, or has no test of the list.
    """
    if is_log(path):
        with open_log(path) as stream:
            yield from (make_recording(record, task) for record in LogReader(stream).records())
        return
    with open_log(path) as stream:
        if is_text_log(stream.peek()):
            yield from _recordings_of_text(stream, task, on_problems)
            return
        lines = enumerate(iter(lambda: stream.readline(MAX_LINE_BYTES + 1), b""), start=1)
        yield from (_find_recording(line, number, task) for number, line in lines)


def _find_recording(line: bytes, number: int, task: Task) -> Recording:
    place = f"Line {number}"
    try:
        content = json.loads(line)
        if isinstance(content, dict) and "state_hashes" in content:
            return make_recording(validate(EpisodeRecord, content, place), task)
        return _recording_of_2025(validate(_EpisodeOf2025, content, place), place, task)
    except (ValueError, RecursionError) as error:
        raise RecordingRejected(f"{place} is not JSON: {error!s:.120}.") from error
    except DocumentRejected as error:
        raise RecordingRejected(str(error)) from error


def _recordings_of_text(stream: BinaryIO, task: Task, on_problems: Callable[[int], object]) -> Iterator[Recording]:
    log = read_text_log(stream)
    script, summary = summarize(log)
    lines = list(to_json_lines(log, script))
    if not lines:
        got = ", ".join(str(episode.number) for episode in log.episodes[:10]) or "none"
        raise TextLogRejected(f"Expected tests 1 to {len(script.starts())} of the list, got {got}.")
    if summary.problems:
        on_problems(len(summary.problems))
    for line in lines:
        place = f"Test {line['episode']}"
        try:
            yield _recording_of_2025(validate(_EpisodeOf2025, line, place), place, task)
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
        episode=find_recorded_episode(task, content.episode, shape, offset, place),
        actions=recorded_actions(task, [step.action for step in content.steps], place),
        infos=tuple(step.model_dump(mode="json", exclude={"action"}, exclude_none=True) for step in content.steps),
        success=None if content.result is None else content.result == "SUCCESS",
    )
