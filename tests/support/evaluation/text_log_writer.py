"""Writes 2025 text logs as the organizers' scripts do, from parsed ones; for tests."""

from collections.abc import Callable, Iterable, Sequence
from datetime import datetime, timedelta
from functools import cache
from typing import Any

import numpy as np


def text_log(
    episodes: Iterable[dict[str, Any]],
    environment: dict[str, Any],
    md5: str,
    totals: Sequence[str] = (),
    team: str = "Touch",
) -> str:
    """The text of a log; episodes as parsed logs have them. Those of 2024 have no MD5."""
    messages = [f"#KEY: {team}"]
    if md5:
        messages += [f"this is MD5: {md5}", "Git Repository Information:", "  branch: main"]
    messages.append("\n-----------Parameters-----\n" + f"{'tac_friction':>30}: {'87.5':<60}\n" + "-----End-----\n")
    messages.append(repr(environment))
    for episode in episodes:
        messages += _episode(episode)
    messages += totals
    start = datetime(2025, 1, 1)
    return "".join(
        f"{(start + timedelta(milliseconds=index)).isoformat(' ', 'milliseconds')} | INFO     | "
        f"__main__:evaluate_policy:1 - {message}\n"
        for index, message in enumerate(messages)
    )


def _episode(episode: dict[str, Any]) -> list[str]:
    messages = [f"#### Test No. {episode['episode']} ####"]
    logs_offsets = "offset_obs" in episode["steps"][0]
    if "initial_offset" in episode:
        messages.append(f"Initial offset: {_float32(episode['initial_offset'])}")
    for step in episode["steps"]:
        messages.append(f"Step {step['n']} Action: {_float32(step['action'])}")
        if logs_offsets:
            messages.append(f"Offset: {_float32(step['offset_obs'])}")
            messages.append(f"info: {_info(step)!r}")
            messages.append(f"Reward: {step['reward']}")
    return [*messages, f"RESULT: {episode['result']}"]


def _info(step: dict[str, Any]) -> dict[str, Any]:
    return {
        "steps": step["info_steps"],
        "surface_diff_m": _Array(step["surface_diff_m"]),
        "tactile_movement_too_large": step["tactile_movement_too_large"],
        "too_many_steps": step["too_many_steps"],
        "error_too_large": step["error_too_large"],
        "peg_relative_z_mm": _Array(step["peg_relative_z_mm"], dtype="float32"),
        "is_success": step["is_success"],
        "relative_motion_mm_deg": _Array(step["relative_motion_mm_deg"]),
        "gt_offset_mm_deg": _Array(step["gt_offset_mm_deg"]),
    }


class _Array:
    """Stands for an array where only its text is wanted."""

    def __init__(self, values: Sequence[float], dtype: str | None = None) -> None:
        self._text = _printed(tuple(values), repr(values), repr, dtype)

    def __repr__(self) -> str:
        return self._text


def _float32(values: Sequence[float]) -> str:
    return _printed(tuple(values), repr(values), str, "float32")


@cache
def _printed(values: tuple[float, ...], _: str, form: Callable[[object], str], dtype: str | None) -> str:
    """An array's text, most of which stand in a log again and again; the second argument tells -0.0 from 0.0."""
    return form(np.array(values, dtype=dtype))
