"""Reward of the peg and the fusion task."""

from collections.abc import Callable
from dataclasses import replace
from math import isclose, radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.envs.tasks.definition import Flags
from vitac.envs.tasks.fusion_insertion.env import FusionInsertionSettings, FusionOffset
from vitac.envs.tasks.insertion.env import (
    InsertionSettings,
    InsertionState,
    compute_flags,
    insertion_reward,
    way_to_the_hole,
)
from vitac.envs.tasks.insertion.interface import PegOffset, is_beyond
from vitac.envs.tasks.peg_insertion.env import PegInsertionSettings
from vitac.envs.tasks.settings import SettingsError

PEG = replace(PegInsertionSettings(), max_steps=8, step_penalty=1.0, final_reward=10.0)
FUSION = replace(FusionInsertionSettings(), max_steps=50, step_penalty=0.8, final_reward=50.0)
FAILURES = [Flags(tactile_movement_too_large=True), Flags(error_too_large=True)]


def rewarded(flags: Flags) -> tuple[float, float]:
    """Reward of the peg task after 3 of 8 env steps, and of the fusion task after 20 of 50."""
    return (
        insertion_reward(flags, PEG, progress=1.0, env_steps=3),
        insertion_reward(flags, FUSION, progress=0.5, env_steps=20),
    )


def test_reward_is_progress_less_the_penalty() -> None:
    assert rewarded(Flags()) == (0.0, 0.5 - 0.8)


def test_success_adds_the_final_reward() -> None:
    assert rewarded(Flags(is_success=True)) == (10.0, 0.5 - 0.8 + 50.0)


@pytest.mark.parametrize("flags", FAILURES)
def test_tactile_and_error_cost_two_for_every_step_left_less_one(flags: Flags) -> None:
    assert rewarded(flags) == pytest.approx((-10.0 + 1.0, 0.5 - 0.8 - 2 * 0.8 * 30 + 0.8))


@pytest.mark.parametrize("flags", FAILURES)
def test_a_flag_is_paid_for_even_where_the_goal_is_reached(flags: Flags) -> None:
    assert rewarded(replace(flags, is_success=True)) == rewarded(flags)


def test_running_out_of_steps_costs_nothing_more() -> None:
    assert insertion_reward(Flags(too_many_steps=True), PEG, progress=1.0, env_steps=8) == 0.0


@given(x_mm=st.floats(-12.0, 12.0), y_mm=st.floats(-30.0, 30.0), theta_deg=st.floats(-20.0, 20.0))
def test_way_ends_at_the_hole_whatever_the_angle(x_mm: float, y_mm: float, theta_deg: float) -> None:
    along, across, turn = way_to_the_hole((x_mm, y_mm, theta_deg))
    angle = radians(theta_deg)
    world = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ [along, across]
    assert np.allclose(world + np.array([x_mm, y_mm]), 0.0, atol=1e-12)
    assert theta_deg + turn == 0.0


NUMBERS = st.floats(-50.0, 50.0)


@given(x_mm=NUMBERS, y_mm=NUMBERS, theta_deg=NUMBERS, z_mm=NUMBERS)
def test_every_number_of_an_offset_counts_in_its_array_and_magnitude(
    x_mm: float, y_mm: float, theta_deg: float, z_mm: float
) -> None:
    flat = PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg)
    high = FusionOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg, z_mm=z_mm)
    assert flat.as_array().tolist() == [x_mm, y_mm, theta_deg]
    assert high.as_array().tolist() == [x_mm, y_mm, theta_deg, z_mm]
    for offset in (flat, high):
        assert isclose(offset.magnitude(), float(np.linalg.norm(offset.as_array())), abs_tol=1e-12)


@pytest.mark.parametrize(("value", "beyond"), [(12.0, False), (12.000009, False), (12.00002, True), (11.0, False)])
def test_limit_holds_either_way_and_is_itself_allowed(value: float, beyond: bool) -> None:
    assert is_beyond(value, 12.0) is beyond
    assert is_beyond(-value, 12.0) is beyond


HOLE = PegOffset(x_mm=0.0, y_mm=0.0, theta_deg=0.0)


def state(*, env_steps: int = 3, diff_m: float = 0.0, z_mm: tuple[float, ...] = ()) -> InsertionState[PegOffset]:
    return InsertionState(
        env_steps=env_steps,
        offset=HOLE,
        surface_diff_m=np.array([0.0, diff_m]),
        peg_relative_z_mm=np.array(z_mm),
    )


@pytest.mark.parametrize(("z_mm", "deeper"), [((-0.4, -0.31), True), ((-0.4, -0.3), False), ((-0.4, 0.1), False)])
def test_peg_is_deep_where_all_its_corners_are(z_mm: tuple[float, ...], deeper: bool) -> None:
    assert state(z_mm=z_mm).is_deeper_than(0.3) is deeper


def test_goal_counts_where_no_other_flag_is_raised() -> None:
    assert compute_flags(state(), max_steps=8, left_range=False, reached=True) == Flags(is_success=True)
    assert compute_flags(state(), max_steps=8, left_range=False, reached=False) == Flags()


def test_every_other_flag_takes_the_goal_away() -> None:
    assert compute_flags(state(), max_steps=8, left_range=True, reached=True) == Flags(error_too_large=True)
    assert compute_flags(state(env_steps=8), max_steps=8, left_range=False, reached=True) == Flags(too_many_steps=True)
    moved = compute_flags(state(diff_m=1.6e-3), max_steps=8, left_range=False, reached=True)
    assert moved == Flags(tactile_movement_too_large=True)


Make = Callable[..., InsertionSettings]
BOTH = pytest.mark.parametrize("make", [PegInsertionSettings, FusionInsertionSettings])


@BOTH
@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("max_steps", 0, "at least 1"),
        ("indentation_mm", 0.0, "0 to 2 mm, half the gel"),
        ("indentation_mm", 2.1, "0 to 2 mm, half the gel"),
        ("gripper_x_mm", -7.1, "-7 to 7 mm"),
        ("gripper_z_mm", 0.1, "-17 to 0 mm"),
        ("gripper_z_mm", -17.1, "-17 to 0 mm"),
        ("peg_friction", -0.1, "0 to 1000"),
        ("peg_friction", float("nan"), "0 to 1000"),
    ],
)
def test_what_no_insertion_can_be_played_with_is_refused_by_name(
    make: Make, name: str, value: float, expected: str
) -> None:
    with pytest.raises(SettingsError, match=rf"^Setting '{name}' is {value!r}, expected {expected}\.$"):
        make(**{name: value})


@BOTH
@pytest.mark.parametrize(
    "changes",
    [{"max_steps": 1}, {"indentation_mm": 2.0}, {"gripper_x_mm": 7.0}, {"gripper_z_mm": -17.0}, {"peg_friction": 1e3}],
)
def test_limits_are_allowed(make: Make, changes: dict[str, float]) -> None:
    (name, value), *_ = changes.items()
    assert getattr(make(**changes), name) == value


@pytest.mark.parametrize(
    ("make", "words", "count"), [(PegInsertionSettings, "three", 3), (FusionInsertionSettings, "four", 4)]
)
def test_scale_has_a_number_for_every_action(make: Make, words: str, count: int) -> None:
    assert make(action_scale_mm_deg=(20.0,) * count).action_scale_mm_deg == (20.0,) * count
    for scale in [(1.0,) * (count - 1), (1.0,) * (count + 1), (1.0,) * (count - 1) + (20.1,), (float("inf"),) * count]:
        with pytest.raises(SettingsError, match=f"expected {words} numbers of 0 to 20"):
            make(action_scale_mm_deg=scale)
