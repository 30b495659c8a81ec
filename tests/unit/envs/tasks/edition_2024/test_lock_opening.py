"""The locks of 2024 on a stand-in for the physics, and their rules on states of known points."""

from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.geometry.keys_and_locks import KeyShape, key_control_points, lock_control_points
from vitac.envs.tasks.definition import Flags
from vitac.envs.tasks.edition_2024.definition import SUCCESS_Z_RANGE_M
from vitac.envs.tasks.edition_2024.env import LockOpening2024Env, alignment_error, reward
from vitac.envs.tasks.lock_opening.definition import LockState, judge_flags
from vitac.envs.tasks.settings import ResetOptionsError

ENTRANCES_MM = {"key1": 46.0, "key2": 52.0, "key3": 46.0, "key4": 62.0}
SENSORS_MM = {"key1": 70.0, "key2": 75.0, "key3": 70.0, "key4": 80.0}


def played(*actions: list[float], options: dict[str, Any], **settings: Any) -> tuple[Any, ...]:
    env = LockOpening2024Env(**settings)
    result: tuple[Any, ...] = env.reset(options={"rng_seed": (0, 1)} | options)
    for action in actions:
        result = env.step(np.array(action, dtype=np.float32))
    return env, *result


def state(*, x_mm: float = 13.0, y_mm: float = 0.0, z_mm: float = 8.5) -> LockState:
    key, lock = key_control_points(KeyShape.KEY1), lock_control_points(KeyShape.KEY1)
    shift = np.array([x_mm, y_mm, z_mm]) * 1e-3
    return LockState(
        env_steps=5,
        rear_tooth_m=key.rear_tooth_m + shift,
        front_tooth_m=key.front_tooth_m + shift,
        rear_slot_m=lock.rear_slot_m,
        front_slot_m=lock.front_slot_m,
        entrance_m=lock.entrance_m,
        surface_diff_m=np.array([1e-4, 1e-4]),
    )


@pytest.mark.parametrize("shape", ENTRANCES_MM)
@pytest.mark.parametrize(("given", "x_mm"), [((3.5, 0, 0), 3.5), ((-2, 5, 5), 0.0), ((12, 0, -1), 10.0)])
def test_key_starts_outside_by_a_clipped_offset(
    physics: list[FakeScene], shape: str, given: tuple[float, float, float], x_mm: float
) -> None:
    played(options={"shape": shape, "offset_mm": given, "sensor_jitter_mm": (0.0, 0.0)})
    key, _ = physics[0].bodies
    assert key.translation_m * 1e3 == pytest.approx([ENTRANCES_MM[shape] + x_mm, 0.0, 0.0])
    centre = np.mean([gel.translation_m for gel in physics[0].gels], axis=0) * 1e3
    assert centre == pytest.approx([ENTRANCES_MM[shape] + x_mm + SENSORS_MM[shape], 0.0, 16.0])


def test_settings_are_those_of_the_evaluation_of_2024(physics: list[FakeScene]) -> None:
    env, observation, info = played(options={"shape": "key1", "offset_mm": (0, 0, 0)})
    scene = physics[0]
    contact = scene.contact
    assert (scene.time_step_s, contact.d_hat_m, contact.kappa) == (0.033, 2e-4, 1e3)
    assert (contact.kappa_affine, contact.friction_velocity_m_s) == (1e5, 1e-3)
    assert {gel.friction for gel in scene.gels} == {0.5}
    assert [body.friction for body in scene.bodies] == [0.6, 0.5]
    assert len(info["step_reports"]) == 21  # 1.375 mm at 2 mm/s
    assert set(observation) == {"relative_motion", "marker_flow"}
    assert (env.settings.markers.noise_px, env.settings.markers.loss_probability) == (0.1, 0.0)


def test_sensors_are_displaced_along_the_key_alone() -> None:
    env = LockOpening2024Env()
    places = []
    for seed in range(20):
        env.reset(seed=seed, options={"shape": "key1", "offset_mm": (0, 0, 0)})
        places.append([1e3 * env.scene.pose.x_m - 116.0, 1e3 * env.scene.pose.z_m - 16.0])
    x_mm, z_mm = np.array(places).T
    assert np.ptp(x_mm) > 2.0
    assert np.abs(x_mm).max() <= 2.0
    assert np.allclose(z_mm, 0.0)


@pytest.mark.parametrize(
    ("action", "moved_mm", "steps"),
    [
        ([1.0, 0.0, 0.0], (-4.0, 0.0, 0.0), 61),
        ([0.0, -0.5, 0.5], (0.0, 1.0, -1.0), 15),
        ([2.0, 1.5, -1.5], (-8.0, -3.0, 3.0), 121),
        ([0.0, 0.0, 0.0], (0.0, 0.0, 0.0), 1),
    ],
)
def test_every_axis_is_negated_and_nothing_is_clipped(
    action: list[float], moved_mm: tuple[float, float, float], steps: int
) -> None:
    *_, info = played(action, options={"shape": "key1", "offset_mm": (5, 0, 0)})
    assert info["relative_motion_mm"] == pytest.approx(moved_mm)
    assert len(info["step_reports"]) == steps


def test_a_motion_without_end_is_bounded_and_leaves_the_range() -> None:
    *_, truncated, info = played([-1e30, 0.0, 0.0], options={"shape": "key1", "offset_mm": (0, 0, 0)})
    assert info["relative_motion_mm"][0] == pytest.approx(120.0)
    assert (truncated, info["end_reason"]) == (True, "error")


@pytest.mark.parametrize(
    ("changes", "success"),
    [
        ({"z_mm": 7.99}, False),
        ({"z_mm": 8.01}, True),
        ({"z_mm": 10.99}, True),
        ({"z_mm": 11.0}, False),
        ({"y_mm": 1.99}, True),
        ({"y_mm": -2.01}, False),
        ({"x_mm": -3.99}, True),
        ({"x_mm": -4.01}, False),
        ({"x_mm": 21.99}, True),
        ({"x_mm": 22.01}, False),
    ],
)
def test_boundaries_of_success(changes: dict[str, float], *, success: bool) -> None:
    found = judge_flags(state(**changes), max_steps=100, success_z_range_m=SUCCESS_Z_RANGE_M)
    assert found.is_success is success


def test_error_is_squared_and_has_a_step_at_the_entrance() -> None:
    # Teeth 2 mm from their slots, 1 mm sideways, at 34 mm: inside.
    assert alignment_error(state(x_mm=15.0, y_mm=-1.0, z_mm=5.0)) == pytest.approx(4 * 2 * (4 + 1 + 9))
    # Rear tooth at 46.5 to 50.5 mm: outside, 26.5 mm away, teeth at 29 mm.
    assert alignment_error(state(x_mm=39.5, z_mm=0.0)) == pytest.approx(4 * 2 * (26.5**2 + 1 + 64))


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (Flags(), 0.0),
        (Flags(is_success=True, error_too_large=True), 10.0),
        (Flags(error_too_large=True), -300.0),
        (Flags(tactile_movement_too_large=True), -300.0),
        (Flags(too_many_steps=True), 0.0),
    ],
)
def test_reward_has_progress_gels_and_end(flags: Flags, expected: float) -> None:
    found = reward(
        flags, np.array([1e-4, 1e-3]), progress=7.0, step_penalty=1.0, final_reward=10.0, failure_penalty=300.0
    )
    gels = 10 / (1.55 - 0.2) + 10 / (1.55 - 1.0) - 15
    assert found == pytest.approx(7.0 - 1.0 - gels + expected)


def test_failure_costs_ten_penalties_for_each_env_step_left() -> None:
    _, _, found, _, truncated, info = played([0.0, 6.0, 0.0], options={"shape": "key1", "offset_mm": (0, 0, 0)})
    assert (truncated, info["end_reason"]) == (True, "error")
    progress = -4 * 2 * 12.0**2
    gels = 2 * 10 / 1.35 - 15
    assert found == pytest.approx(progress - 1.0 - gels - 10.0 * 99, rel=1e-6)


def test_offset_that_is_no_number_is_refused() -> None:
    with pytest.raises(ResetOptionsError, match="LockOpening2024-v1: option 'offset_mm'"):
        LockOpening2024Env().reset(options={"offset_mm": (1, 2)})
