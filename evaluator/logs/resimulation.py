"""Re-simulates recorded actions of logs, ours and those of 2025, and compares."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final, Self

from pydantic import BaseModel, ConfigDict, JsonValue, PositiveInt, SerializerFunctionWrapHandler, model_serializer

from ..episodes.episode import Environment, Resimulated, make_environment, resimulate
from ..episodes.records import EpisodeOutcome, EpisodeRecord
from ..strict_model import DocumentRejected, StrictModel, validate
from ..tracks import Task, load_track
from .log import MAX_LINE_BYTES, LogReader, is_log, open_log
from .recordings import Recording, RecordingRejected, find_recorded_episode, make_recording, recorded_actions
from .text_2025 import TextLogRejected, TextLogSummary, is_text_log, read_text_log, summarize, to_json_lines
from .text_2025.recordings import track_and_task_names
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


CANNOT_BE_VERIFIED: Final = (
    "A 2025 text log holds no states, and the 2025 simulator does not reproduce itself, so it cannot be verified: its "
    "numbers are checked against each other and the published rules, and its actions are re-simulated."
)


class ResimulatedTest(StrictModel):
    """How one test ended in the log and here; an env step is None where the recorded actions end before the test."""

    number: int
    claimed_success: bool
    success: bool
    logged_env_steps: int
    end_step: int | None


class TextLogCheck(StrictModel):
    """What a text log says, what is wrong with it, and where its actions lead in our physics."""

    track: str
    task: str
    summary: TextLogSummary
    missing_tests: int
    tests: tuple[ResimulatedTest, ...]

    @property
    def is_consistent(self) -> bool:
        """Whether it is whole and no number in it contradicts another."""
        return not self.missing_tests and not self.summary.problems

    @property
    def successes(self) -> int:
        """Tests that succeed here."""
        return sum(test.success for test in self.tests)

    @property
    def same_ends(self) -> int:
        """Tests that end here at the logged env step, and with the logged result."""
        return sum(
            test.end_step == test.logged_env_steps and test.success == test.claimed_success for test in self.tests
        )

    @classmethod
    def from_file(cls, path: Path, on_test: Callable[[int], object]) -> Self:
        """Check and re-simulate a text log.

        Args:
            path: the file, gzipped or not.
            on_test: gets the number of each re-simulated test.

        Raises:
            TextLogRejected: it cannot be read, or no task here is its own.
        """
        with open_log(path) as stream:
            script, summary = summarize(read_text_log(stream))
        track, name = track_and_task_names(script)
        task = load_track(track).tasks.get(name)
        if task is None:
            raise TextLogRejected(f"The log is of {script.name}, but there is no track with its task here.")
        tests = tuple(_tests(path, task, on_test))
        missing = len(task.episodes) - len(tests)
        return cls(track=track, task=name, summary=summary, missing_tests=missing, tests=tests)


def is_text_log_file(path: Path) -> bool:
    """Return whether a file starts like a 2025 text log, gzipped or not."""
    with open_log(path) as stream:
        return is_text_log(stream.peek())


def _tests(path: Path, task: Task, on_test: Callable[[int], object]) -> list[ResimulatedTest]:
    env, tests = make_environment(task.apply_text_log_settings(), None, ()), []
    for recording in read_recordings(path, task):
        played = resimulate(env, recording.episode, recording.actions)
        tests.append(
            ResimulatedTest(
                number=recording.episode.number,
                claimed_success=recording.success is True,
                success=played.outcome is EpisodeOutcome.SUCCESS,
                logged_env_steps=len(recording.actions),
                end_step=played.end_step,
            )
        )
        on_test(recording.episode.number)
    return tests
