"""The report of `vitac resimulate`: recorded actions in our physics, beside the recorded results."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pydantic import JsonValue, SerializerFunctionWrapHandler, model_serializer

from ..episodes.episode import Environment
from ..episodes.records import EpisodeOutcome
from ..episodes.replay import Resimulated, resimulate
from ..strict_model import StrictModel
from ..tracks import Task
from .recordings import Recording

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
