"""Converts a 2025 text log to JSON lines, one object per episode (challenge-facts 13)."""

from collections.abc import Iterator
from datetime import datetime
from typing import Any

from .checks import hole_top, tests_of_list
from .reader import TextEpisode, TextLog, TextStep
from .scripts import Script, Start

_INFO_KEYS = (
    "surface_diff_m",
    "tactile_movement_too_large",
    "too_many_steps",
    "error_too_large",
    "peg_relative_z_mm",
    "is_success",
    "relative_motion_mm_deg",
    "gt_offset_mm_deg",
)


def to_json_lines(log: TextLog, script: Script) -> Iterator[dict[str, Any]]:
    """Yield one JSON object for each episode that is also in the list, with the start that has its number there.

    `result` is None where the log has none, as at a log's end that was cut off.
    """
    starts = script.starts(hole_top(log, script))
    for episode, start in tests_of_list(log, starts):
        yield _episode(episode, start, script)


def _episode(episode: TextEpisode, start: Start, script: Script) -> dict[str, Any]:
    results = {True: "SUCCESS", False: "FAIL", None: None}
    content: dict[str, Any] = {
        "episode": episode.number,
        "task": script.task,
        "shape_index": start.shape_index,
        "repeat_index": start.repeat_index,
        "offset_index": start.offset_index,
        "initial_offset": list(episode.initial_offset or start.offset),
        "steps": [_step(step) for step in episode.steps],
        "result": results[episode.success],
        "t_start": episode.started.isoformat(timespec="milliseconds"),
        "shape": start.shape,
        "reset_s": _seconds(episode.started, episode.reset_ended),
        "wall_s": _seconds(episode.started, episode.ended),
    }
    return content | ({"choose_left": start.shape_index} if script.hole_tops_mm else {})


def _step(step: TextStep) -> dict[str, Any]:
    content: dict[str, Any] = {"n": step.n, "action": list(step.action), "wall_s": _seconds(step.started, step.ended)}
    if step.info:
        content |= {"offset_obs": list(step.offset or ()), "info_steps": step.info.get("steps")}
        content |= {key: step.info[key] for key in _INFO_KEYS if key in step.info} | {"reward": step.reward}
    return content


def _seconds(start: datetime, end: datetime | None) -> float | None:
    return round((end - start).total_seconds(), 3) if end else None
