"""Flags and success of the fusion task (challenge-facts 6.3)."""

from dataclasses import replace

import numpy as np
import pytest
from vitac.envs.tasks.ending import Flags
from vitac.envs.tasks.fusion_insertion.task import judge_flags
from vitac.envs.tasks.fusion_insertion.variation import FusionOffset
from vitac.envs.tasks.insertion.state import InsertionState

SEATED = InsertionState(
    env_steps=20,
    offset=FusionOffset(x_mm=0.5, y_mm=-0.5, theta_deg=1.0, z_mm=8.0),
    surface_diff_m=np.array([1e-4, 1e-4]),
    peg_relative_z_mm=np.array([-1.2, -1.1, -1.3, -1.2]),
)


def judged(state: InsertionState[FusionOffset]) -> Flags:
    return judge_flags(state, max_steps=50, insertion_depth_mm=1.0)


def moved(**offset: float) -> InsertionState[FusionOffset]:
    return replace(SEATED, offset=replace(SEATED.offset, **offset))


def test_a_peg_deep_in_the_right_hole_is_a_success() -> None:
    assert judged(SEATED) == Flags(is_success=True)


def test_every_corner_must_be_deep_enough() -> None:
    assert not judged(replace(SEATED, peg_relative_z_mm=np.array([-1.2, -0.99, -1.3, -1.2]))).is_success
    assert not judged(replace(SEATED, peg_relative_z_mm=np.array([-1.2, -1.0, -1.3, -1.2]))).is_success


@pytest.mark.parametrize("offset", [{"x_mm": 6.0}, {"x_mm": -6.0}, {"y_mm": 6.0}, {"y_mm": -6.0}, {"theta_deg": 10.0}])
def test_a_peg_deep_in_another_place_is_none(offset: dict[str, float]) -> None:
    assert judged(moved(**offset)) == Flags()
    assert judged(moved(**{name: 0.999 * value for name, value in offset.items()})).is_success


@pytest.mark.parametrize(
    ("offset", "limit"), [("x_mm", 12.0), ("y_mm", 30.0), ("theta_deg", 20.0), ("z_mm", 32.4), ("z_mm", 2.4)]
)
def test_an_offset_beyond_its_limit_is_an_error(offset: str, limit: float) -> None:
    outwards = 1e-3 if limit > 2.4 else -1e-3
    assert not judged(moved(**{offset: limit})).error_too_large
    flags = judged(moved(**{offset: limit + outwards}))
    assert flags.error_too_large
    assert not flags.is_success


def test_moved_surface_or_used_up_steps_prevent_success() -> None:
    tactile = judged(replace(SEATED, surface_diff_m=np.array([1e-4, 1.6e-3])))
    assert tactile == Flags(tactile_movement_too_large=True)
    assert judged(replace(SEATED, env_steps=50)) == Flags(too_many_steps=True)
    assert judged(replace(SEATED, env_steps=49)).is_success
