"""A log of our own making, a short list solved by going straight to the hole, in which one thing is wrong at a time."""

import io
import math
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Any

import pytest
from text_log_writer import text_log
from vitac.evaluator.logs.text_2025 import (
    TextEpisode,
    TextLog,
    TextLogRejected,
    TextLogSummary,
    check,
    read_text_log,
    scripts,
    summarize,
)
from vitac.evaluator.logs.text_2025.checks import hole_top

OFFICIAL_SCRIPTS = scripts.all_scripts()
OFFICIAL = next(script for script in OFFICIAL_SCRIPTS if script.name == "track 1 peg insertion")
PEG = OFFICIAL.model_copy(update={"repeats": 1, "offsets": OFFICIAL.offsets[:5]})
VISION = next(script for script in OFFICIAL_SCRIPTS if script.hole_tops_mm)


@pytest.fixture(autouse=True)
def short_list(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scripts, "all_scripts", lambda: (PEG,))


def read(text: str) -> TextLog:
    return read_text_log(io.BytesIO(text.encode()))


def summary_of(text: str) -> TextLogSummary:
    return summarize(read(text))[1]


def solved_episode(number: int, start: tuple[float, ...], shape: str) -> dict[str, Any]:
    offset, steps = list(start), []
    for n in (1, 2, 3):
        angle, before = math.radians(offset[2]), math.hypot(*offset)
        x, y = -offset[0], -offset[1]
        own = [x * math.cos(angle) + y * math.sin(angle), y * math.cos(angle) - x * math.sin(angle), -offset[2]]
        action = [round(min(max(v / s, -1), 1), 6) for v, s in zip(own, (2, 2, 4), strict=True)]
        motion = [a * s for a, s in zip(action, (2, 2, 4), strict=True)]
        offset[0] += motion[0] * math.cos(angle) - motion[1] * math.sin(angle)
        offset[1] += motion[0] * math.sin(angle) + motion[1] * math.cos(angle)
        offset[2] += motion[2]
        steps.append(
            {
                "n": n,
                "action": action,
                "offset_obs": list(offset),
                "info_steps": n,
                "surface_diff_m": [0.0005, 0.0006],
                "tactile_movement_too_large": False,
                "too_many_steps": False,
                "error_too_large": False,
                "peg_relative_z_mm": [-0.4, -0.5, -0.4, -0.4],
                "is_success": n == 3,
                "relative_motion_mm_deg": [o - s for o, s in zip(offset, start, strict=True)] + [-0.125 * n],
                "gt_offset_mm_deg": list(offset),
                "reward": before - math.hypot(*offset) - 1 + (10 if n == 3 else 0),
            }
        )
    return {"episode": number, "shape": shape, "initial_offset": list(start), "steps": steps, "result": "SUCCESS"}


def own_log(
    change: Callable[[list[dict[str, Any]]], Any] = lambda _: None,
    environment: dict[str, Any] | None = None,
    md5: str = PEG.md5[0],
    totals: tuple[str, ...] = ("#SUCCESS_RATE: 100.00%", "#AVG_STEP: 3.00"),
) -> str:
    episodes = [solved_episode(i, start.offset, start.shape) for i, start in enumerate(PEG.starts(), start=1)]
    change(episodes)
    return text_log(episodes, environment or PEG.environment, md5, totals)


def problems(text: str) -> tuple[str, ...]:
    return summary_of(text).problems


def test_own_log_has_no_problem() -> None:
    summary = summary_of(own_log())
    assert summary.problems == ()
    assert (summary.episodes, summary.success_rate, summary.claimed_success_rate) == (15, 1.0, 1.0)
    assert (summary.claimed_average_steps, summary.team) == (3.0, "Touch")


@pytest.mark.parametrize(
    ("key", "value", "problem"),
    [
        ("action", [0.5, 0.5, 0.5], "the action does not lead to offset"),
        ("action", [1.5, 0, 0], "test 4: env step 2 has an action outside [-1, 1]"),
        ("action", [0.5, 0.5], "test 4: env step 2: expected 3 action values, got 2"),
        ("offset_obs", [9.0, 0.0, 0.0], "expected the offset of the info"),
        ("info_steps", 7, "test 4: env step 2: expected 2 in info steps, got 7"),
        ("info_steps", "\x1b[2J\x00\ud800", "in info steps, got '\\x1b[2J\\x00\\ud800'"),
        ("surface_diff_m", [0.0005, 0.0016], "tactile_movement_too_large: expected True by the rules, got False"),
        ("surface_diff_m", [0.0005], "lacks info surface_diff_m of 2 numbers"),
        ("too_many_steps", True, "too_many_steps: expected False by the rules, got True"),
        ("error_too_large", True, "error_too_large: expected False by the rules, got True"),
        ("is_success", True, "is_success: expected False by the rules, got True"),
        ("peg_relative_z_mm", [], "test 4: env step 2 lacks info peg_relative_z_mm"),
        (
            "relative_motion_mm_deg",
            [0, 0, 0, -0.25],
            "env step 2: relative motion (0.0, 0.0, 0.0, -0.25) does not follow",
        ),
        ("gt_offset_mm_deg", [0.0, 0.0, 0.0], "the action does not lead to offset"),
        ("reward", 10.0, "test 4: env step 2: reward 10.0 does not follow from the rules"),
    ],
)
def test_one_fault_in_an_env_step_is_found(key: str, value: object, problem: str) -> None:
    found = problems(own_log(lambda episodes: episodes[3]["steps"][1].update({key: value})))
    assert found
    assert any(problem in text for text in found)
    assert all(text.startswith("test 4: ") for text in found)


def test_success_before_the_third_step_is_impossible() -> None:
    def shorten(episodes: list[dict[str, Any]]) -> None:
        episodes[12]["steps"].pop()
        episodes[12]["steps"][1].update(is_success=True)

    assert any(
        "test 13: env step 2: is_success: expected False by the rules, got True" in text
        for text in problems(own_log(shorten))
    )


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (
            lambda e: e[1].update(initial_offset=[0.0, 0.0, 0.0]),
            "test 2: expected the start (-4.0, -4.0, -8.0), got (0.0, 0.0, 0.0)",
        ),
        (lambda e: e[1].update(initial_offset=[1.0]), "test 2: expected the start (-4.0, -4.0, -8.0), got (1.0,)"),
        (
            lambda e: e[1].update(initial_offset=[1, 2, 3, 4]),
            "test 2: expected the start (-4.0, -4.0, -8.0), got (1.0, 2.0, 3.0, 4.0)",
        ),
        (lambda e: e[1].update(result="FAIL"), "test 2: RESULT says FAIL, the last env step the opposite"),
        (lambda e: e[1]["steps"].pop(), "test 2: env step 2 is the last, but did not end the test"),
        (
            lambda e: e[1]["steps"].append(e[1]["steps"][2] | {"n": 4}),
            "test 2: env step 3 ended the test, but is not the last",
        ),
        (lambda e: e.pop(), "expected the 15 tests of the list, got 14"),
        (lambda e: e.insert(0, e.pop(1)), "expected test 1, got test 2"),
    ],
)
def test_one_fault_in_a_test_is_found(change: Callable[[list[dict[str, Any]]], Any], problem: str) -> None:
    found = problems(own_log(change))
    assert any(problem in text for text in found), found


@pytest.mark.parametrize(
    ("totals", "problem"),
    [
        ((), "the log has no totals at its end"),
        (("#SUCCESS_RATE: 99.63%", "#AVG_STEP: 3.00"), "the success rate is 100.00 %, the log claims 99.63 %"),
        (("#SUCCESS_RATE: 0", "#AVG_STEP: 3.00"), "the log claims 0.00 %"),
        (("#SUCCESS_RATE: 100.00%", "#AVG_STEP: 2.99"), "the average of env steps is 3.00, the log claims 2.99"),
        (("#SUCCESS_RATE: 100.00%", "#AVG_STEP: NA"), "the average of env steps is 3.0, the log claims None"),
        (("#SUCCESS_RATE: " + "9" * 300 + ".00%", "#AVG_STEP: 3.00"), "unknown message '#SUCCESS_RATE: 999"),
    ],
)
def test_false_totals_are_found(totals: tuple[str, ...], problem: str) -> None:
    found = problems(own_log(totals=totals))
    assert any(problem in text for text in found), found


def test_other_script_is_found() -> None:
    assert problems(own_log(md5="0" * 32)) == (
        f"expected the published script's MD5 60c79ed6fbb14a804fe317d9ab4559f9, got {'0' * 32}",
    )


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"max_steps": 80}, "environment: expected the official max_steps = 8, got 80"),
        ({"cheat": 1}, "environment: 'cheat' is not an official setting"),
    ],
)
def test_other_settings_are_found(change: dict[str, Any], problem: str) -> None:
    assert problems(own_log(environment=PEG.environment | change)) == (problem,)


def test_a_long_value_makes_no_long_problem() -> None:
    found = problems(own_log(lambda episodes: episodes[3]["steps"][1].update(info_steps="A" * 100_000)))
    assert 0 < len(found[0]) < 100


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2025-01-01 10:00:00.123 | INFO     | a:b:1 - hello\n", "expected a 2025 text log with"),
        (own_log(environment={"max_speed": 3}), "not that of any task of the challenge"),
        (own_log().replace("'steps': 1", "'steps': nan", 1), "expected a plain finite value, got"),
    ],
)
def test_what_cannot_be_a_log_of_the_challenge_is_refused(text: str, message: str) -> None:
    with pytest.raises(TextLogRejected, match=message):
        summary_of(text)


def turned_episode(turns: Sequence[float], rewards: Sequence[float], **last: Any) -> dict[str, Any]:
    """Test 1, in which the policy only turns the peg; `last` is what the info of the last env step says otherwise."""
    start = PEG.starts()[0].offset
    angle, steps = start[2], []
    for n, (turn, reward) in enumerate(zip(turns, rewards, strict=True), start=1):
        angle += 4 * turn
        offset = [start[0], start[1], angle]
        steps.append(
            {
                "n": n,
                "action": [0.0, 0.0, turn],
                "offset_obs": offset,
                "info_steps": n,
                "surface_diff_m": [0.0005, 0.0006],
                "tactile_movement_too_large": False,
                "too_many_steps": False,
                "error_too_large": False,
                "peg_relative_z_mm": [0.1, 0.1, 0.1, 0.1],
                "is_success": False,
                "relative_motion_mm_deg": [0.0, 0.0, angle - start[2], -0.125 * n],
                "gt_offset_mm_deg": offset,
                "reward": reward,
            }
        )
    steps[-1] |= last
    return {"episode": 1, "initial_offset": list(start), "steps": steps, "result": "FAIL"}


def problems_of_first(episode: dict[str, Any]) -> tuple[str, ...]:
    """Problems of a log whose first test failed so, and all others succeeded."""
    totals = ("#SUCCESS_RATE: 93.33%", "#AVG_STEP: 3.00")
    return problems(own_log(lambda episodes: episodes.__setitem__(0, episode), totals=totals))


def test_one_env_step_more_than_allowed_is_found() -> None:
    idle = turned_episode([0] * 9, [-1] * 9, too_many_steps=True)
    idle["steps"][7]["too_many_steps"] = True
    assert problems_of_first(idle) == (
        "test 1: expected at most 8 env steps, got 9",
        "test 1: env step 8 ended the test, but is not the last",
    )


@pytest.mark.parametrize("surface_diff_m", [[0.0016, 0.0005], [0.0005, 0.0016]])
def test_a_slipped_gel_of_either_sensor_ends_a_test_and_costs_the_steps_that_are_left(
    surface_diff_m: list[float],
) -> None:
    slipped = {"surface_diff_m": surface_diff_m, "tactile_movement_too_large": True}
    assert problems_of_first(turned_episode([0, 0], [-1, -12], **slipped)) == ()
    assert problems_of_first(turned_episode([0, 0], [-1, -13], **slipped)) == (
        "test 1: env step 2: reward -13.0 does not follow from the rules",
    )


def test_a_gel_may_move_as_far_as_the_limit() -> None:
    assert problems_of_first(turned_episode([0] * 8, [-1] * 8, too_many_steps=True, surface_diff_m=[0.0015] * 2)) == ()


def test_an_angle_beyond_its_limit_ends_a_test() -> None:
    first = math.hypot(4, 4, 8) - math.hypot(4, 4, 12) - 1
    second = math.hypot(4, 4, 12) - math.hypot(4, 4, 16) - 12
    assert problems_of_first(turned_episode([-1, -1], [first, second], error_too_large=True)) == ()


def test_an_angle_may_reach_its_limit() -> None:
    first = math.hypot(4, 4, 8) - math.hypot(4, 4, 12) - 1
    second = math.hypot(4, 4, 12) - math.hypot(4, 4, 15) - 1
    rewards = [first, second, *[-1.0] * 6]
    assert problems_of_first(turned_episode([-1, -0.75, *[0.0] * 6], rewards, too_many_steps=True)) == ()


def test_a_peg_exactly_as_deep_as_the_limit_is_no_success() -> None:
    found = problems(own_log(lambda episodes: episodes[0]["steps"][2].update(peg_relative_z_mm=[-0.3, -0.4])))
    assert found == ("test 1: env step 3: is_success: expected False by the rules, got True",)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda log: setattr(log, "script_md5", None), "the header has no MD5 of the script"),
        (lambda log: log.parameters.clear(), "the header has no parameters"),
        (
            lambda log: log.environment.pop("max_steps"),
            "environment: expected the official max_steps = 8, got None",
        ),
        (lambda log: setattr(log.episodes[1], "initial_offset", None), "test 2: it has no initial offset"),
        (
            lambda log: setattr(log.episodes[-1].steps[0], "reward", None),
            "test 15: env step 1 lacks action, offset or reward",
        ),
        (
            lambda log: setattr(log.episodes[-1].steps[0], "offset", None),
            "test 15: env step 1 lacks action, offset or reward",
        ),
        (
            lambda log: setattr(log.episodes[-1].steps[0], "offset", (1.0,)),
            "test 15: env step 1 lacks action, offset or reward",
        ),
    ],
)
def test_what_a_log_lacks_is_its_only_problem(change: Callable[[TextLog], object], expected: str) -> None:
    log = read(own_log())
    change(log)
    assert check(log, PEG) == [expected]


def test_a_test_without_result_or_env_steps_is_told_once_for_each() -> None:
    log = read(own_log())
    log.episodes[4].success, log.episodes[4].steps = None, []
    assert check(log, PEG)[:2] == ["test 5: it has no RESULT", "test 5: it has no env steps"]


@pytest.mark.parametrize(
    ("key", "value", "lacking"),
    [
        ("surface_diff_m", (True, 0.1), "info surface_diff_m of 2 numbers"),
        ("surface_diff_m", "ab", "info surface_diff_m of 2 numbers"),
        ("relative_motion_mm_deg", (0.0, 0.0, 0.0), "info relative_motion_mm_deg of 4 numbers"),
        ("gt_offset_mm_deg", (0.0, 0.0), "info gt_offset_mm_deg of 3 numbers"),
        ("peg_relative_z_mm", ("deep",), "info peg_relative_z_mm"),
        ("peg_relative_z_mm", 0.5, "info peg_relative_z_mm"),
        ("tactile_movement_too_large", 0, "info tactile_movement_too_large"),
        ("too_many_steps", 0, "info too_many_steps"),
        ("error_too_large", None, "info error_too_large"),
        ("is_success", "no", "info is_success"),
    ],
)
def test_an_info_without_a_value_of_the_right_form_is_not_judged_further(key: str, value: object, lacking: str) -> None:
    log = read(own_log())
    log.episodes[2].steps[1].info[key] = value
    assert check(log, PEG) == [f"test 3: env step 2 lacks {lacking}"]


@pytest.mark.parametrize("rate", [0.99996, 1.0])
@pytest.mark.parametrize("steps", [2.995, 3.005])
def test_totals_may_be_rounded_to_two_decimals(rate: float, steps: float) -> None:
    log = read(own_log())
    log.claimed_success_rate, log.claimed_average_steps = rate, steps
    assert check(log, PEG) == []


@pytest.mark.parametrize(("key", "value"), [("claimed_success_rate", 0.9999), ("claimed_average_steps", 3.0052)])
def test_totals_may_not_differ_by_more_than_rounding(key: str, value: float) -> None:
    log = read(own_log())
    setattr(log, key, value)
    assert len(check(log, PEG)) == 1


def test_without_any_success_there_is_no_average() -> None:
    log = read(own_log())
    for episode in log.episodes:
        episode.success = False
    log.claimed_success_rate, log.claimed_average_steps = 0.0, None
    assert not any("average" in problem or "rate" in problem for problem in check(log, PEG))
    log.claimed_average_steps = 3.0
    assert "the average of env steps is None, the log claims 3.0" in check(log, PEG)


def test_a_log_without_tests_claims_nothing() -> None:
    log = read(own_log())
    log.episodes, log.claimed_success_rate, log.claimed_average_steps = [], 0.0, None
    assert check(log, PEG) == ["expected the 15 tests of the list, got 0"]


def shown(*offset: float, number: int = 1) -> TextLog:
    """A vision log whose only test has this number and starts there."""
    return TextLog(episodes=[TextEpisode(line=1, number=number, started=datetime(2025, 1, 1), initial_offset=offset)])


@pytest.mark.parametrize("top_mm", VISION.hole_tops_mm)
def test_the_holes_top_is_recognised_whichever_test_of_the_list_comes_first(top_mm: float) -> None:
    starts = VISION.starts(top_mm)
    for number in range(1, len(starts) + 1, 6):
        log = shown(*starts[number - 1].offset, number=number)
        assert hole_top(log, VISION) == top_mm, f"test {number}"
        assert not [problem for problem in check(log, VISION) if "expected the start" in problem]


def test_the_holes_top_is_told_by_the_first_test_of_the_list_that_prints_its_start() -> None:
    top_mm = VISION.hole_tops_mm[-1]
    starts = VISION.starts(top_mm)
    log = shown(0.0, 0.0, 0.0, 99.0, number=0)
    assert hole_top(log, VISION) is None, "a test of no list tells nothing"
    for number, offset in ((3, None), (5, (1.0,)), (9, starts[8].offset), (10, VISION.starts()[9].offset)):
        log.episodes.append(
            TextEpisode(line=number, number=number, started=datetime(2025, 1, 1), initial_offset=offset)
        )
    assert hole_top(log, VISION) == top_mm
    found = [problem for problem in check(log, VISION) if "expected the start" in problem]
    assert [problem.partition(":")[0] for problem in found] == ["test 5", "test 10"]


def test_without_a_start_in_four_numbers_the_holes_top_is_unknown() -> None:
    assert hole_top(shown(1.0, 2.0, 3.0), VISION) is None
    assert hole_top(TextLog(), VISION) is None
    assert hole_top(shown(*VISION.starts()[0].offset), PEG) is None


def test_offsets_that_do_not_follow_are_told_with_what_the_log_says() -> None:
    log = read(own_log())
    step = log.episodes[3].steps[1]
    step.offset = (9.0, 0.0, 0.0)
    truth = step.info["gt_offset_mm_deg"]
    assert check(log, PEG) == [f"test 4: env step 2: expected the offset of the info, {truth}, got (9.0, 0.0, 0.0)"]


def test_unofficial_settings_are_told_in_one_order() -> None:
    log = read(own_log(environment={**PEG.environment, "zeta": 1, "alpha": 2, "vision_params": 3}))
    assert check(log, PEG) == [
        "environment: 'alpha' is not an official setting",
        "environment: 'zeta' is not an official setting",
    ]


@pytest.mark.parametrize(("off", "is_told"), [(0.00009, False), (-0.00009, False), (0.0002, True), (-0.0002, True)])
def test_a_reward_may_differ_by_what_printing_rounds(off: float, is_told: bool) -> None:
    log = read(own_log())
    step = log.episodes[0].steps[0]
    assert step.reward is not None
    step.reward += off
    assert bool(check(log, PEG)) == is_told


def test_a_reward_of_nothing_is_one() -> None:
    """The peg turns just so much nearer as a step costs."""
    near = math.sqrt((math.hypot(4, 4, 8) - 1) ** 2 - 32)
    turn = (8 - near) / 4
    found = problems_of_first(turned_episode([turn, *[0.0] * 7], [0.0, *[-1.0] * 7], too_many_steps=True))
    assert found == ()
    too_good = problems_of_first(turned_episode([turn, *[0.0] * 7], [0.1, *[-1.0] * 7], too_many_steps=True))
    assert too_good == ("test 1: env step 1: reward 0.1 does not follow from the rules",)


def test_a_success_against_the_last_env_step_is_told() -> None:
    log = read(own_log())
    log.episodes[5].steps[-1].info["is_success"] = False
    assert "test 6: RESULT says SUCCESS, the last env step the opposite" in check(log, PEG)
