import numpy as np
import pytest
from vitac.envs.tasks.ending import EndReason, Flags
from vitac.envs.tasks.insertion.offset import PegOffset
from vitac.envs.tasks.insertion.state import InsertionState
from vitac.envs.tasks.peg_insertion.task import judge_flags

SEATED = (-0.5, -0.5, -0.5, -0.5)


def flags(
    *,
    env_steps: int = 3,
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    surface_diff_m: tuple[float, float] = (4e-4, 4e-4),
    z_mm: tuple[float, ...] = SEATED,
    z_step_mm: float = 0.125,
) -> Flags:
    x_mm, y_mm, theta_deg = offset
    state = InsertionState(
        env_steps=env_steps,
        offset=PegOffset(x_mm=x_mm, y_mm=y_mm, theta_deg=theta_deg),
        surface_diff_m=np.array(surface_diff_m),
        peg_relative_z_mm=np.array(z_mm),
    )
    return judge_flags(state, max_steps=8, z_step_mm=z_step_mm)


@pytest.mark.parametrize(("env_steps", "success"), [(1, False), (2, False), (3, True), (7, True), (8, False)])
def test_success_needs_the_third_to_the_seventh_env_step(env_steps: int, success: bool) -> None:
    assert flags(env_steps=env_steps).is_success is success


def test_success_needs_the_fifth_env_step_at_the_smaller_descent() -> None:
    assert not flags(env_steps=4, z_step_mm=0.075).is_success
    assert flags(env_steps=5, z_step_mm=0.075).is_success


def test_success_needs_every_corner_inside() -> None:
    assert not flags(z_mm=(-0.5, -0.5, -0.5, -0.3)).is_success
    assert flags(z_mm=(-0.5, -0.5, -0.5, -0.301)).is_success


@pytest.mark.parametrize("diff", [(1.51e-3, 0.0), (0.0, 1.51e-3)])
def test_either_sensor_raises_the_tactile_flag_and_blocks_success(diff: tuple[float, float]) -> None:
    raised = flags(surface_diff_m=diff)
    assert raised.tactile_movement_too_large
    assert not raised.is_success
    assert raised.failure is EndReason.TACTILE


def test_the_tactile_limit_itself_is_allowed() -> None:
    assert not flags(surface_diff_m=(1.5e-3, 1.5e-3)).tactile_movement_too_large


@pytest.mark.parametrize(
    ("offset", "raised"),
    [
        ((12.0, 0, 0), False),
        ((12.00002, 0, 0), True),
        ((0, -12.00002, 0), True),
        ((12.0, 12.0, 15.0), False),
        ((0, 0, -15.00002), True),
    ],
)
def test_error_flag_is_a_box_on_the_commanded_offset(offset: tuple[float, float, float], raised: bool) -> None:
    assert flags(offset=offset).error_too_large is raised


def test_first_of_several_flags_names_the_end() -> None:
    assert flags(env_steps=8, surface_diff_m=(2e-3, 0), offset=(13, 0, 0)).failure is EndReason.TACTILE
    assert flags(env_steps=8, offset=(13, 0, 0)).failure is EndReason.ERROR
    assert flags(env_steps=8).failure is EndReason.STEPS
    assert flags().failure is None
