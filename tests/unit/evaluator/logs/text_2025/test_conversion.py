"""A 2025 text log as JSON lines: what each holds, and what it lacks where the log did."""

import json
from datetime import datetime, timedelta
from typing import Any

import pytest
from vitac.evaluator.logs.text_2025.checks import to_json_lines
from vitac.evaluator.logs.text_2025.reader import TextEpisode, TextLog, TextStep
from vitac.evaluator.logs.text_2025.scripts import Script, all_scripts

PEG, LOCK, FUSION, *_ = all_scripts()
BEGIN = datetime(2025, 3, 1, 12, 0, 0, 250_000)


def after(seconds: float) -> datetime:
    return BEGIN + timedelta(seconds=seconds)


def step(n: int, **changes: Any) -> TextStep:
    return TextStep(**{"line": n, "n": n, "action": (0.5, -1.0, 0.0), "started": after(n), **changes})


def episode(number: int = 1, *steps: TextStep, **changes: Any) -> TextEpisode:
    return TextEpisode(**{"line": 1, "number": number, "started": BEGIN, "steps": list(steps), **changes})


def converted(log: TextLog, script: Script = PEG) -> list[dict[str, Any]]:
    """The lines as a reader of the file gets them."""
    found = json.loads(json.dumps(list(to_json_lines(log, script)), allow_nan=False))
    assert isinstance(found, list)
    return found


def test_a_whole_test_of_the_peg_becomes_a_line() -> None:
    info = {
        "steps": 1,
        "surface_diff_m": (0.001, 0.002),
        "tactile_movement_too_large": False,
        "too_many_steps": False,
        "error_too_large": True,
        "peg_relative_z_mm": (1.0, 2.0),
        "is_success": False,
        "relative_motion_mm_deg": (0.0, 0.0, 0.0, -0.5),
        "gt_offset_mm_deg": (1.0, 2.0, 3.0),
        "of another script": 5,
    }
    one = step(1, info=info, offset=(1.0, 2.0, 3.0), reward=-0.25, ended=after(1.5))
    log = TextLog(
        episodes=[
            episode(1, one, initial_offset=(9.0, 9.0, 9.0), reset_ended=after(0.75), success=True, ended=after(2))
        ]
    )
    (line,) = converted(log)
    (kept,) = line.pop("steps")
    start = PEG.starts()[0]
    assert line == {
        "episode": 1,
        "task": "peg_insertion",
        "shape_index": start.shape_index,
        "repeat_index": 0,
        "offset_index": 0,
        "initial_offset": [9.0, 9.0, 9.0],
        "result": "SUCCESS",
        "t_start": "2025-03-01T12:00:00.250",
        "shape": start.shape,
        "reset_s": 0.75,
        "wall_s": 2.0,
    }
    assert kept.pop("info_steps") == info.pop("steps")
    info.pop("of another script")
    assert kept == {
        "n": 1,
        "action": [0.5, -1.0, 0.0],
        "wall_s": 0.5,
        "offset_obs": [1.0, 2.0, 3.0],
        "reward": -0.25,
        **json.loads(json.dumps(info)),
    }


def test_a_log_with_actions_only_has_no_more() -> None:
    (line,) = converted(TextLog(episodes=[episode(1, step(1), step(2, ended=after(3)))]), LOCK)
    assert line["steps"] == [
        {"n": 1, "action": [0.5, -1.0, 0.0], "wall_s": None},
        {"n": 2, "action": [0.5, -1.0, 0.0], "wall_s": 1.0},
    ]
    assert line["initial_offset"] == list(LOCK.starts()[0].offset)


def test_a_step_whose_info_lacks_keys_has_the_others() -> None:
    (line,) = converted(TextLog(episodes=[episode(1, step(1, info={"is_success": True}))]))
    (kept,) = line["steps"]
    assert (kept["is_success"], kept["info_steps"], kept["offset_obs"], kept["reward"]) == (True, None, [], None)
    assert "surface_diff_m" not in kept


@pytest.mark.parametrize(("success", "result"), [(True, "SUCCESS"), (False, "FAIL"), (None, None)])
def test_only_a_success_is_one(success: bool | None, result: str | None) -> None:
    assert converted(TextLog(episodes=[episode(success=success)]))[0]["result"] == result


def test_times_that_are_not_known_are_none_and_others_have_milliseconds() -> None:
    (line,) = converted(TextLog(episodes=[episode(reset_ended=after(0.123_456))]))
    assert (line["reset_s"], line["wall_s"]) == (0.123, None)


def test_tests_beyond_the_list_are_left_out_and_the_others_follow_its_order() -> None:
    log = TextLog(episodes=[episode(number) for number in range(1, len(PEG.starts()) + 4)])
    lines = converted(log)
    assert [line["episode"] for line in lines] == list(range(1, len(PEG.starts()) + 1))
    assert [(line["repeat_index"], line["offset_index"], line["shape_index"]) for line in lines] == [
        (start.repeat_index, start.offset_index, start.shape_index) for start in PEG.starts()
    ]


def test_a_test_has_the_start_of_its_number_where_others_are_missing_or_have_none() -> None:
    log = TextLog(episodes=[episode(number) for number in (0, 2, 5, len(PEG.starts()) + 1)])
    found = [(line["episode"], line["shape"], line["initial_offset"]) for line in converted(log)]
    second, fifth = PEG.starts()[1], PEG.starts()[4]
    assert found == [(2, second.shape, list(second.offset)), (5, fifth.shape, list(fifth.offset))]


@pytest.mark.parametrize("top_mm", FUSION.hole_tops_mm)
def test_a_vision_log_says_the_side_and_starts_in_the_books_of_its_era(top_mm: float) -> None:
    starts = FUSION.starts(top_mm)
    log = TextLog(episodes=[episode(1, initial_offset=starts[0].offset), episode(2), episode(3)])
    lines = converted(log, FUSION)
    assert [line["choose_left"] for line in lines] == [start.shape_index for start in starts[:3]]
    assert [line["initial_offset"] for line in lines] == [list(start.offset) for start in starts[:3]]


def test_other_logs_have_no_side() -> None:
    assert "choose_left" not in converted(TextLog(episodes=[episode()]))[0]
