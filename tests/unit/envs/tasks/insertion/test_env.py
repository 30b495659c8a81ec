"""Reward of the peg and the fusion task."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vitac.envs.tasks.definition import Flags
from vitac.envs.tasks.fusion_insertion.scene import FusionInsertionSettings
from vitac.envs.tasks.insertion.env import insertion_reward, way_to_the_hole
from vitac.envs.tasks.peg_insertion.scene import PegInsertionSettings

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
