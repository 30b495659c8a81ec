from dataclasses import replace

import numpy as np
import pytest
from vitac.envs.geometry.keys_and_locks import KeyShape, key_control_points, lock_control_points
from vitac.envs.tasks.definition import EndReason, Flags
from vitac.envs.tasks.lock_opening.definition import LockState, alignment_error, judge_flags, reward


def state(
    *,
    x_mm: float = 13.0,
    y_mm: float = 0.0,
    z_mm: float = 6.0,
    shape: KeyShape = KeyShape.KEY1,
    env_steps: int = 5,
    surface_diff_m: tuple[float, float] = (1e-4, 1e-4),
) -> LockState:
    """The key moved from its own frame by x, y, z; x = 13 is aligned, z = 6 lifts it well."""
    key, lock = key_control_points(shape), lock_control_points(shape)
    shift = np.array([x_mm, y_mm, z_mm]) * 1e-3
    return LockState(
        env_steps=env_steps,
        rear_tooth_m=key.rear_tooth_m + shift,
        front_tooth_m=key.front_tooth_m + shift,
        rear_slot_m=lock.rear_slot_m,
        front_slot_m=lock.front_slot_m,
        entrance_m=lock.entrance_m,
        surface_diff_m=np.array(surface_diff_m),
    )


def flags(*, x_mm: float = 13.0, y_mm: float = 0.0, z_mm: float = 6.0) -> Flags:
    return judge_flags(state(x_mm=x_mm, y_mm=y_mm, z_mm=z_mm), max_steps=50)


@pytest.mark.parametrize("shape", KeyShape)
def test_aligned_and_lifted_key_succeeds(shape: KeyShape) -> None:
    assert judge_flags(state(shape=shape), max_steps=50).is_success


@pytest.mark.parametrize(("z_mm", "success"), [(4.0, False), (4.01, True), (10.99, True), (11.0, False)])
def test_teeth_must_stand_between_33_and_40_mm(z_mm: float, success: bool) -> None:
    assert flags(z_mm=z_mm).is_success is success


def test_one_low_corner_blocks_success() -> None:
    lifted = state()
    lifted.front_tooth_m[2, 2] = 0.0329
    assert not judge_flags(lifted, max_steps=50).is_success


@pytest.mark.parametrize(("y_mm", "success"), [(1.9, True), (-1.9, True), (2.1, False), (-2.1, False)])
def test_teeth_must_stand_within_2_mm_of_the_middle(y_mm: float, success: bool) -> None:
    assert flags(y_mm=y_mm).is_success is success


@pytest.mark.parametrize(("x_mm", "success"), [(-3.9, True), (-4.1, False), (21.9, True), (22.1, False)])
def test_teeth_must_stand_inside_the_lock(x_mm: float, success: bool) -> None:
    assert flags(x_mm=x_mm).is_success is success


def test_success_asks_for_no_flag() -> None:
    raised = judge_flags(state(env_steps=50, surface_diff_m=(2e-3, 0.0)), max_steps=50)
    assert raised.is_success
    assert raised.tactile_movement_too_large
    assert raised.failure is EndReason.TACTILE


@pytest.mark.parametrize(
    "place", [{"y_mm": 10.1}, {"y_mm": -10.1}, {"z_mm": 16.1}, {"z_mm": -14.1}, {"x_mm": 110.0 - 22.0 + 0.1}]
)
def test_tooth_far_out_of_place_is_an_error(place: dict[str, float]) -> None:
    raised = flags(**place)
    assert raised.error_too_large
    assert not raised.is_success
    assert raised.failure is EndReason.ERROR


@pytest.mark.parametrize("place", [{"y_mm": 9.9}, {"z_mm": 15.9}, {"z_mm": -13.9}, {"x_mm": 87.9}])
def test_error_limits_are_wide(place: dict[str, float]) -> None:
    assert not flags(**place).error_too_large


def test_last_env_step_cuts_off() -> None:
    assert judge_flags(state(env_steps=50, z_mm=0.0), max_steps=50).failure is EndReason.STEPS
    assert judge_flags(state(env_steps=49, z_mm=0.0), max_steps=50).failure is None


def test_alignment_error_asks_for_lifting_inside_the_lock() -> None:
    # Both teeth 2 mm off in x, at 29 + 5 mm of 37, and 1 mm aside.
    assert alignment_error(state(x_mm=11.0, y_mm=-1.0, z_mm=5.0)) == pytest.approx(500 * 2 * (2 + 1 + 3) * 1e-3)


def test_alignment_error_asks_for_the_ceiling_outside() -> None:
    # Rear tooth ends at 24 + 23 = 47 mm, beyond the entrance at 46.
    assert alignment_error(state(x_mm=23.0, z_mm=0.0)) == pytest.approx(500 * 2 * (10 + 1) * 1e-3)


def gained(raised: Flags, surface_diff_m: tuple[float, float] = (0.0, 0.0)) -> float:
    return reward(
        raised,
        np.array(surface_diff_m),
        progress=2.0,
        step_penalty=1.0,
        final_reward=10.0,
        failure_penalty=5.0,
    )


def test_reward_charges_both_surfaces_between_two_tenths_and_one_and_a_half() -> None:
    running = flags(z_mm=0.0)
    assert gained(running) == pytest.approx(1.0 - 0.4)
    assert gained(running, (0.5e-3, 0.0)) == pytest.approx(1.0 - 0.7)
    assert gained(running, (9e-3, 9e-3)) == pytest.approx(1.0 - 3.0)


def test_success_outweighs_a_flag_in_the_reward() -> None:
    assert gained(judge_flags(state(surface_diff_m=(2e-3, 0)), max_steps=50)) == pytest.approx(11.0 - 0.4)


def test_failure_costs_a_flat_five_but_the_last_step_nothing() -> None:
    assert gained(flags(y_mm=10.1)) == pytest.approx(1.0 - 0.4 - 5.0)
    assert gained(replace(flags(z_mm=0.0), too_many_steps=True)) == pytest.approx(1.0 - 0.4)
