"""The report of `vitac resimulate`: recorded actions in our physics, beside the recorded results."""

from collections.abc import Iterable, Iterator
from typing import Any

from pydantic import JsonValue

from ..episodes.episode import Environment
from ..episodes.records import EpisodeOutcome
from ..episodes.replay import Resimulated, resimulate
from ..strict_model import StrictModel
from .recordings import Recording

_FLAGS = ("is_success", "tactile_movement_too_large", "error_too_large")
_TEETH = ("key1_pts_m", "key2_pts_m")


class ReportedStep(StrictModel):
    """One env step, lengths in mm. The JSON omits quantities that the task does not have.

    `tooth_z_mm` is the height of the lowest top corner of the rear and of the front measured tooth.
    """

    n: int
    surface_diff_mm: tuple[float, ...] | None = None
    peg_relative_z_mm: tuple[float, ...] | None = None
    tooth_z_mm: tuple[float, ...] | None = None
    is_success: bool | None = None
    tactile_movement_too_large: bool | None = None
    error_too_large: bool | None = None


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


def resimulate_all(env: Environment, recordings: Iterable[Recording]) -> Iterator[tuple[Recording, ReportedEpisode]]:
    """Re-simulate the recordings one at a time; yield each with its report."""
    for recording in recordings:
        yield recording, _episode(recording, resimulate(env, recording.episode, recording.actions))


def report(env: Environment, episodes: Iterable[ReportedEpisode]) -> Report:
    """Return the report on all episodes that this environment has run since it was made."""
    return Report(
        episodes=tuple(episodes),
        solver_version=env.solver_version,
        ipc_steps=env.ipc_steps,
        cpu_s_per_ipc_step=env.physics_cpu_s / env.ipc_steps if env.ipc_steps else 0.0,
    )


def reported_step(number: int, info: dict[str, JsonValue]) -> ReportedStep:
    """Return the reported part of the info of one env step, ours or recorded."""
    known: dict[str, Any] = {key: info[key] for key in ("peg_relative_z_mm", *_FLAGS) if key in info}
    if "surface_diff_m" in info:
        metres: Any = info["surface_diff_m"]
        known["surface_diff_mm"] = tuple(1000 * value for value in metres)
    if all(key in info for key in _TEETH):
        teeth: Any = [info[key] for key in _TEETH]
        known["tooth_z_mm"] = tuple(1000 * min(z for _, _, z in tooth) for tooth in teeth)
    return ReportedStep.model_validate({"n": number, **known})


def _episode(recording: Recording, played: Resimulated) -> ReportedEpisode:
    return ReportedEpisode(
        episode=recording.episode.number,
        steps=tuple(reported_step(number, info) for number, info in enumerate(played.infos, start=1)),
        success=played.outcome is EpisodeOutcome.SUCCESS,
        end_step=played.end_step,
        end_reason=played.outcome,
    )
