"""Checks of a text log of 2025 or 2024, its summary, and its conversion to JSON lines."""

from collections.abc import Iterator, Sequence
from datetime import datetime
from math import cos, hypot, isclose, radians, sin
from typing import Any, Final

from ...strict_model import StrictModel
from .messages import TextLogRejected
from .reader import TextEpisode, TextLog, TextStep
from .scripts import PegRules, PrintedStart, Script, find_script, is_printed


def check(log: TextLog, script: Script) -> list[str]:
    """Return what is wrong with a log besides misplaced lines; one sentence each, with a line or test number."""
    return [*_check_header(log, script), *_check_episodes(log, script), *_check_totals(log)]


def hole_top(log: TextLog, script: Script) -> float | None:
    """Return the hole's top that the log was made with [mm]; None if the script has none or the log prints none.

    The first test of the list that prints its start tells.
    """
    if not script.hole_tops_mm:
        return None
    for episode, start in tests_of_list(log, script.starts()):
        shown = episode.initial_offset
        if shown is not None and len(shown) >= 4:
            shown_top_mm = script.hole_tops_mm[0] + shown[3] - start.offset[3]
            return min(script.hole_tops_mm, key=lambda top_mm: abs(top_mm - shown_top_mm))
    return None


def tests_of_list(log: TextLog, starts: Sequence[PrintedStart]) -> Iterator[tuple[TextEpisode, PrintedStart]]:
    """Yield each test whose number is in the list, with the start that has this number there."""
    for episode in log.episodes:
        if 1 <= episode.number <= len(starts):
            yield episode, starts[episode.number - 1]


def _check_header(log: TextLog, script: Script) -> Iterator[str]:
    if log.script_md5 is None and script.md5:
        yield "the header has no MD5 of the script"
    elif log.script_md5 is not None and log.script_md5 not in script.md5:
        known = f"the published script's MD5 {script.md5[0]}" if script.md5 else "no MD5"
        yield f"expected {known}, got {log.script_md5}"
    for key, official in script.environment.items():
        got = log.environment.get(key)
        if _plain(got) != _plain(official):
            yield f"environment: expected the official {key} = {official!r}, got {got!r:.60}"
    for key in sorted(log.environment.keys() - script.environment.keys() - {"vision_params"}):
        yield f"environment: {key!r:.60} is not an official setting"
    if not log.parameters:
        yield "the header has no parameters"


def _check_episodes(log: TextLog, script: Script) -> Iterator[str]:
    top = hole_top(log, script)
    starts = script.starts(top)
    if len(log.episodes) != len(starts):
        yield f"expected the {len(starts)} tests of the list, got {len(log.episodes)}"
    for episode, start in tests_of_list(log, starts):
        for problem in _check_episode(episode, start, script, top):
            yield f"test {episode.number}: {problem}"


def _check_episode(episode: TextEpisode, start: PrintedStart, script: Script, top: float | None) -> Iterator[str]:
    if episode.success is None:
        yield "it has no RESULT"
    if not episode.steps:
        yield "it has no env steps"
    if len(episode.steps) > script.max_steps:
        yield f"expected at most {script.max_steps} env steps, got {len(episode.steps)}"
    for step in episode.steps:
        if len(step.action) != script.action_size:
            yield f"env step {step.n}: expected {script.action_size} action values, got {len(step.action)}"
        elif max(map(abs, step.action)) > 1:
            yield f"env step {step.n} has an action outside [-1, 1]"
    if script.peg and episode.initial_offset is None:
        yield "it has no initial offset"
    elif script.peg and episode.initial_offset is not None:
        if not is_printed(episode.initial_offset, start.offset):
            yield f"expected the start {start.offset}, got {episode.initial_offset!s:.80}"
        if len(episode.initial_offset) != len(start.offset):
            return
        check_steps = _check_peg_episode if script.logs_infos else _check_offsets
        yield from check_steps(episode, episode.initial_offset, script, script.peg, top)


def _check_offsets(
    episode: TextEpisode, start: tuple[float, ...], script: Script, rules: PegRules, _: float | None
) -> Iterator[str]:
    """Check a test of 2024, which has offsets alone: where the actions lead, and whether it can end where it does."""
    before: Sequence[float] = start
    for step in episode.steps:
        if step.offset is None or len(step.offset) != script.action_size or len(step.action) != script.action_size:
            yield f"env step {step.n} lacks action or offset"
            return
        if not is_printed(step.offset, _moved(before, step.action, rules)):
            yield f"env step {step.n}: the action does not lead to offset {step.offset}"
        before = step.offset
        is_last, has_left = step is episode.steps[-1], _has_left_range(step.offset, rules)
        if has_left and not is_last:
            yield f"env step {step.n} ended the test, but is not the last"
        if is_last and not (has_left or episode.success or step.n >= script.max_steps):
            yield f"env step {step.n} is the last, but did not end the test"
        if is_last and episode.success and (has_left or step.n * rules.descent_per_step_mm <= rules.commanded_depth_mm):
            yield "RESULT says SUCCESS, which its last env step cannot be"


def _has_left_range(offset: Sequence[float], rules: PegRules) -> bool:
    return any(abs(value) > limit + 1e-5 for value, limit in zip(offset, rules.offset_limit, strict=True))


def _check_peg_episode(
    episode: TextEpisode, start: tuple[float, ...], script: Script, rules: PegRules, top: float | None
) -> Iterator[str]:
    before = start
    for step in episode.steps:
        missing = _missing(step, script)
        if missing:
            yield f"env step {step.n} lacks {missing}"
            return
        for problem in _check_step(step, before, start, script, rules, top):
            yield f"env step {step.n}: {problem}"
        before = step.info["gt_offset_mm_deg"]
        ended = step.info["is_success"] or _flagged(step)
        if ended != (step is episode.steps[-1]):
            fault = "ended the test, but is not the last" if ended else "is the last, but did not end the test"
            yield f"env step {step.n} {fault}"
    if episode.steps and episode.success != episode.steps[-1].info["is_success"]:
        yield f"RESULT says {'SUCCESS' if episode.success else 'FAIL'}, the last env step the opposite"


def _missing(step: TextStep, script: Script) -> str | None:
    size = script.action_size
    lengths = {
        "surface_diff_m": 2,
        "relative_motion_mm_deg": 4,
        "gt_offset_mm_deg": size,
    }
    for key, length in lengths.items():
        value = step.info.get(key)
        if not isinstance(value, tuple) or len(value) != length or not all(_is_number(item) for item in value):
            return f"info {key} of {length} numbers"
    heights = step.info.get("peg_relative_z_mm")
    if not isinstance(heights, tuple) or not heights or not all(_is_number(item) for item in heights):
        return "info peg_relative_z_mm"
    for key in ("tactile_movement_too_large", "too_many_steps", "error_too_large", "is_success"):
        if not isinstance(step.info.get(key), bool):
            return f"info {key}"
    if step.offset is None or len(step.offset) != size or step.reward is None or len(step.action) != size:
        return "action, offset or reward"
    return None


def _check_step(
    step: TextStep, before: Sequence[float], start: Sequence[float], script: Script, rules: PegRules, top: float | None
) -> Iterator[str]:
    info, offset = step.info, step.info["gt_offset_mm_deg"]
    if info.get("steps") != step.n:
        yield f"expected {step.n} in info steps, got {info.get('steps')!r:.40}"
    if not is_printed(offset, _moved(before, step.action, rules)):
        yield f"the action does not lead to offset {offset}"
    if not is_printed(step.offset or (), offset):
        yield f"expected the offset of the info, {offset}, got {step.offset}"
    motion = [now - then for now, then in zip(offset, start, strict=True)]
    if len(motion) == 3:
        motion.append(-step.n * rules.descent_per_step_mm)
    if not is_printed(info["relative_motion_mm_deg"], motion):
        yield f"relative motion {info['relative_motion_mm_deg']} does not follow from the offset"
    yield from _check_flags(step, script, rules, top)
    if not isclose(step.reward or 0.0, _reward(step, before, script, rules), abs_tol=1e-4):
        yield f"reward {step.reward} does not follow from the rules"


def _check_flags(step: TextStep, script: Script, rules: PegRules, top: float | None) -> Iterator[str]:
    info, offset = step.info, list(step.info["gt_offset_mm_deg"])
    if top is not None:
        offset[3] -= top
    expected = {
        "tactile_movement_too_large": max(info["surface_diff_m"]) > rules.surface_limit_m,
        "too_many_steps": step.n >= script.max_steps,
        "error_too_large": _has_left_range(offset, rules),
    }
    deep = step.n * rules.descent_per_step_mm > rules.commanded_depth_mm or not rules.commanded_depth_mm
    inserted = max(info["peg_relative_z_mm"]) < -rules.depth_mm
    centred = all(abs(value) < limit for value, limit in zip(offset, rules.success_limit, strict=False))
    expected["is_success"] = not any(expected.values()) and deep and inserted and centred
    for key, value in expected.items():
        if info[key] != value:
            yield f"{key}: expected {value} by the rules, got {info[key]}"


def _moved(before: Sequence[float], action: Sequence[float], rules: PegRules) -> list[float]:
    """Return the commanded offset after an action: scaled, clipped, xy turned by the angle before it."""
    pairs = zip(action, rules.action_scale, strict=True)
    motion = [min(max(value * scale, -scale), scale) for value, scale in pairs]
    angle = radians(before[2])
    x, y = motion[0], motion[1]
    motion[0], motion[1] = x * cos(angle) - y * sin(angle), x * sin(angle) + y * cos(angle)
    return [value + change for value, change in zip(before, motion, strict=True)]


def _reward(step: TextStep, before: Sequence[float], script: Script, rules: PegRules) -> float:
    """Return progress minus penalty, plus the final reward."""
    progress = hypot(*before) - hypot(*step.info["gt_offset_mm_deg"])
    reward = progress - rules.step_penalty
    if step.info["tactile_movement_too_large"] or step.info["error_too_large"]:
        return reward - 2 * rules.step_penalty * (script.max_steps - step.n) + rules.step_penalty
    return reward + (rules.final_reward if step.info["is_success"] else 0.0)


def _check_totals(log: TextLog) -> Iterator[str]:
    if not log.has_totals:
        yield "the log has no totals at its end"
        return
    steps = [len(episode.steps) for episode in log.episodes if episode.success]
    rate = len(steps) / len(log.episodes) if log.episodes else 0.0
    claimed = log.claimed_success_rate or 0.0
    if not isclose(claimed, rate, abs_tol=0.5001e-4):
        yield f"the success rate is {100 * rate:.2f} %, the log claims {100 * claimed:.2f} %"
    mean = sum(steps) / len(steps) if steps else None
    if (mean is None) != (log.claimed_average_steps is None):
        yield f"the average of env steps is {mean}, the log claims {log.claimed_average_steps}"
    elif mean is not None and not isclose(log.claimed_average_steps or 0.0, mean, abs_tol=0.00501):
        yield f"the average of env steps is {mean:.2f}, the log claims {log.claimed_average_steps}"


def _flagged(step: TextStep) -> bool:
    return any(step.info[key] for key in ("tactile_movement_too_large", "too_many_steps", "error_too_large"))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _plain(value: object) -> object:
    """Return the value with lists as tuples, so that printed and configured values compare equal."""
    if isinstance(value, list | tuple):
        return tuple(_plain(item) for item in value)
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return value


WHY_RATES_DIFFER: Final = (
    "Claimed and re-simulated rate differ systematically: in the 2025 simulator the same actions lead to other states, "
    "from the first env step on. That it stops after 5 Newton iterations explains about a quarter of it."
)


class TextLogSummary(StrictModel):
    """What a log says, what it claims in its last lines, and what is wrong with it."""

    task: str
    track: str
    team: str
    script_md5: str | None
    era: str | None = None
    """Which books it was made with, where there have been several, recognised from its numbers."""
    episodes: int
    successes: int
    success_rate: float
    claimed_success_rate: float | None
    claimed_average_steps: float | None
    problems: tuple[str, ...]


def summarize(log: TextLog) -> tuple[Script, TextLogSummary]:
    """Return the script that wrote a log, and the log's summary.

    Raises:
        TextLogRejected: its environment is not that of any known script.
    """
    script = find_script(log.environment, has_md5=log.script_md5 is not None)
    if script is None:
        raise TextLogRejected("The environment in the header is not that of any task of the challenge.")
    successes = sum(episode.success is True for episode in log.episodes)
    return script, TextLogSummary(
        task=script.task,
        track=script.track,
        team=log.team or "",
        script_md5=log.script_md5,
        era=script.era(hole_top(log, script)),
        episodes=len(log.episodes),
        successes=successes,
        success_rate=successes / len(log.episodes) if log.episodes else 0.0,
        claimed_success_rate=log.claimed_success_rate,
        claimed_average_steps=log.claimed_average_steps,
        problems=(*log.problems, *check(log, script)),
    )


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


def _episode(episode: TextEpisode, start: PrintedStart, script: Script) -> dict[str, Any]:
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
    if step.info or step.offset is not None:
        content["offset_obs"] = list(step.offset or ())
    if step.info:
        content["info_steps"] = step.info.get("steps")
        content |= {key: step.info[key] for key in _INFO_KEYS if key in step.info} | {"reward": step.reward}
    return content


def _seconds(start: datetime, end: datetime | None) -> float | None:
    return round((end - start).total_seconds(), 3) if end else None
