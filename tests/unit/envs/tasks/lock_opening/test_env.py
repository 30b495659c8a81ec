"""The lock environment on a stand-in for the physics: motions, observations, info, ends and refusals."""

from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.geometry.keys_and_locks import KeyShape, key_control_points
from vitac.envs.tasks.lock_opening.definition import CEILING_Z_M, PERSPECTIVE, SUCCESS_Z_RANGE_M
from vitac.envs.tasks.lock_opening.env import (
    MOUNTS,
    SENSOR_X_MM,
    KeyOffset,
    LockOpeningEnv,
    LockStart,
    SensorJitter,
    out_and_up,
)
from vitac.envs.tasks.settings import ResetOptionsError, SettingsError
from vitac.envs.tasks.task_env import ActionError

START = {"shape": "key1", "offset_mm": (0.0, 0.0, 0.0), "sensor_jitter_mm": (1.0, -0.5), "rng_seed": (0, 1)}
OUT, IN, UP, STAY = [-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 0.0]


def played(*actions: list[float], options: dict[str, Any] | None = None, **settings: Any) -> tuple[Any, ...]:
    env = LockOpeningEnv(**settings)
    result: tuple[Any, ...] = env.reset(options=START | (options or {}))
    for action in actions:
        result = env.step(np.array(action, dtype=np.float32))
    return env, *result


def test_gel_axes_stand_as_in_the_challenge() -> None:
    left, right = (mount.rotation for mount in MOUNTS)
    x, y, z = np.eye(3)
    assert (left @ x == x).all()
    assert (left @ y == -z).all()
    assert (left @ z == y).all()
    assert (right @ x == x).all()
    assert (right @ y == z).all()
    assert (right @ z == -y).all()
    assert (MOUNTS[0].side, MOUNTS[1].side) == (-1, 1)


@pytest.mark.parametrize("shape", KeyShape)
def test_sensors_grip_the_handle_off_by_the_jitter(shape: KeyShape, physics: list[FakeScene]) -> None:
    played(options={"shape": str(shape), "offset_mm": (2.0, 0.0, 0.0)})
    left, right = (gel.translation_m * 1e3 for gel in physics[0].gels)
    x_mm = 6.5 + 2.0 + SENSOR_X_MM[shape] + 1.0
    assert left == pytest.approx([x_mm, -5.5, 15.5])
    assert right == pytest.approx([x_mm, 5.5, 15.5])


def test_grasp_takes_three_ipc_steps_of_a_fifth_of_a_second(physics: list[FakeScene]) -> None:
    env, _, info = played()
    assert env.ipc_steps == len(info["step_reports"]) == 3
    assert physics[0].time_step_s == 0.2
    assert physics[0].contact.friction_velocity_m_s == 1e-3
    centres = [targets.mean(axis=0)[1] * 1e3 for targets in physics[0].targets_m[-1]]
    # Back faces, 2 mm behind the gel centres, which close from 5.5 mm by 1.375 mm.
    assert centres == pytest.approx([-(4.125 + 2.0), 4.125 + 2.0])


def test_key_and_lock_are_placed_as_the_offset_says(physics: list[FakeScene]) -> None:
    played(options={"offset_mm": (4.75, 0.5, -0.25)})
    key, lock = physics[0].bodies
    assert key.translation_m * 1e3 == pytest.approx([11.25, 0.5, -0.25])
    assert (key.friction, lock.friction, key.fixed, lock.fixed) == (0.6, 0.5, False, True)


@pytest.mark.parametrize(
    ("action", "motion_mm", "ipc_steps"),
    [
        ([1.0, 0.0], [-2.0, 0.0, 0.0], 5),
        ([-1.0, 0.0], [2.0, 0.0, 0.0], 5),
        ([0.0, 1.0], [0.0, 0.0, -1.0], 2),
        ([-0.5, -1.0], [1.0, 0.0, 1.0], 2),
        ([0.0, 0.0], [0.0, 0.0, 0.0], 1),
        ([-30.0, 0.0], [2.0, 0.0, 0.0], 5),
    ],
)
def test_positive_actions_push_in_and_down(action: list[float], motion_mm: list[float], ipc_steps: int) -> None:
    env, observation, *_, info = played(action)
    assert info["relative_motion_mm"] == pytest.approx(motion_mm)
    assert observation["relative_motion"] == pytest.approx(motion_mm)
    assert env.ipc_steps == 3 + ipc_steps


@pytest.mark.parametrize(
    ("shape", "jump_mm"),
    [(KeyShape.KEY1, 20.5), (KeyShape.KEY2, 25.5), (KeyShape.KEY3, 20.5), (KeyShape.KEY4, 30.5)],
)
def test_relative_motion_gives_the_key_away_only_as_a_quirk(shape: KeyShape, jump_mm: float) -> None:
    options = {"shape": str(shape)}
    _, first, _ = played(options=options, reference_quirks=True)
    assert first["relative_motion"].tolist() == [0.0, 0.0, 0.0]
    _, observation, *_ = played(OUT, options=options, reference_quirks=True)
    assert observation["relative_motion"] == pytest.approx([jump_mm + 2.0, 0.0, 0.0])
    _, observation, *_ = played(OUT, options=options)
    assert observation["relative_motion"] == pytest.approx([2.0, 0.0, 0.0])


def test_pulled_out_and_lifted_key_succeeds() -> None:
    *_, terminated, truncated, info = played(OUT, OUT, OUT, UP, UP, UP, UP)
    assert (terminated, truncated, info["end_reason"]) == (False, False, None)
    _, _, reward, terminated, truncated, info = played(OUT, OUT, OUT, UP, UP, UP, UP, UP)
    assert (terminated, truncated, info["end_reason"]) == (True, False, "success")
    # 1 mm nearer with two teeth, less the penalty and 0.2 mm for each surface.
    assert reward == pytest.approx(10.0 + 1.0 - 1.0 - 0.4)


def test_success_with_a_tactile_flag_counts_as_success(physics: list[FakeScene]) -> None:
    env, *_ = played(OUT, OUT, OUT, UP, UP, UP, UP)
    physics[0].bulge_m = 2e-3
    _, _, terminated, truncated, info = env.step(np.array(UP, dtype=np.float32))
    assert (terminated, truncated, info["end_reason"]) == (True, True, "success")
    assert info["tactile_movement_too_large"] is True


def test_surface_motion_cuts_the_episode_off(physics: list[FakeScene]) -> None:
    env, *_ = played()
    physics[0].bulge_m = 1.6e-3
    _, reward, terminated, truncated, info = env.step(np.array(STAY, dtype=np.float32))
    assert (terminated, truncated, info["end_reason"]) == (False, True, "tactile")
    assert reward == pytest.approx(-1.0 - 3.0 - 5.0)


def test_fiftieth_env_step_is_the_last() -> None:
    *_, truncated, info = played(*[STAY] * 49)
    assert (truncated, info["end_reason"]) == (False, None)
    *_, truncated, info = played(*[STAY] * 50)
    assert (truncated, info["end_reason"], info["steps"]) == (True, "steps", 50)


def test_step_that_does_not_converge_ends_the_episode_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeScene, "statuses", [*[StepStatus.CONVERGED] * 5, StepStatus.NOT_CONVERGED])
    env, *_, terminated, truncated, info = played(OUT)
    assert (terminated, truncated, info["end_reason"]) == (False, True, "not_converged")
    assert env.ipc_steps == 6


def test_info_keys_come_in_the_order_of_the_2025_code() -> None:
    *_, info = played(STAY)
    assert list(info) == [
        "steps",
        "key1_pts_m",
        "key2_pts_m",
        "key_side_pts_m",
        "lock1_pts_m",
        "lock2_pts_m",
        "lock_side_pts_m",
        "surface_diff_m",
        "tactile_movement_too_large",
        "relative_motion_mm",
        "error_too_large",
        "is_success",
        "end_reason",
        "step_reports",
    ]


def test_info_arrays_belong_to_the_caller() -> None:
    env, _, first = played()
    first["lock1_pts_m"][:] = 0.0
    *_, second = env.step(np.zeros(2, dtype=np.float32))
    assert second["lock1_pts_m"][:, 2] == pytest.approx(0.030)
    assert not np.shares_memory(first["lock_side_pts_m"], second["lock_side_pts_m"])


def test_measured_points_follow_the_key() -> None:
    *_, info = played(OUT, UP)
    points = key_control_points(KeyShape.KEY1)
    shift = np.array([6.5 + 2.0, 0.0, 1.0]) * 1e-3
    assert info["key1_pts_m"] == pytest.approx(points.rear_tooth_m + shift)
    assert info["key2_pts_m"] == pytest.approx(points.front_tooth_m + shift)
    assert info["key_side_pts_m"] == pytest.approx(points.tip_m + shift)


def test_privileged_observation_holds_points_and_scaled_distances() -> None:
    _, observation, _ = played(privileged=True)
    assert set(observation) == {
        *("key_side_pts", "lock1_pts", "lock2_pts", "lock_side_pts", "key1", "key2"),
        *("relative_motion", "marker_flow"),
        *("shape", "measured_pose", "contact_forces", "surface_pts"),
    }
    # Teeth 6.5 mm too deep, 1 mm below the ceiling; 200 per metre.
    assert observation["key1"] == pytest.approx([-1.3, 0.0, -0.2], abs=1e-6)
    assert observation["key2"] == pytest.approx([-1.3, 0.0, -0.2], abs=1e-6)
    assert observation["lock_side_pts"][:, 0] == pytest.approx([0.046] * 4)


def test_public_observation_has_two_keys() -> None:
    env, observation, _ = played()
    assert set(observation) == {"relative_motion", "marker_flow"}
    assert observation in env.observation_space


def test_rng_seed_fixes_jitter_and_noise() -> None:
    options = {key: value for key, value in START.items() if key != "sensor_jitter_mm"}
    env = LockOpeningEnv()
    first, _ = env.reset(options=options)
    place = env.scene.pose
    second, _ = env.reset(options=options)
    assert np.array_equal(first["marker_flow"], second["marker_flow"])
    assert env.scene.pose == place
    env.reset(options=options | {"rng_seed": (0, 2)})
    assert env.scene.pose != place


def test_unusable_action_and_option_are_refused() -> None:
    env, *_ = played()
    with pytest.raises(ActionError, match=r"shape \(3,\), expected \(2,\) \[x mm, z mm\] for ViTac/LockOpening-v1"):
        env.step(np.zeros(3, dtype=np.float32))
    with pytest.raises(ResetOptionsError, match=r"'offset_mm_deg'; did you mean 'offset_mm'\?"):
        env.reset(options={"offset_mm_deg": (0, 0, 0)})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_steps", 0),
        ("action_scale_mm", (1.0, -2.0)),
        ("action_scale_mm", (2.0, 1.0, 1.0)),
        ("indentation_mm", 0.0),
        ("key_friction", -0.1),
        ("random_x_mm", 21.0),
        ("jitter_mm", 5.0),
        ("reference_quirks", 1),
    ],
)
def test_setting_out_of_range_is_refused(name: str, value: Any) -> None:
    with pytest.raises(SettingsError, match=f"'{name}'"):
        LockOpeningEnv(**{name: value})


def test_mesh_hash_depends_on_settings() -> None:
    assert LockOpeningEnv().mesh_hash() == LockOpeningEnv(privileged=True).mesh_hash()
    assert LockOpeningEnv().mesh_hash() != LockOpeningEnv(key_friction=0.7).mesh_hash()


def info(x_mm: float, z_mm: float) -> dict[str, np.ndarray]:
    """Both teeth this far inside their slots (towards +x) and above the ceiling."""
    slot_m = np.array([[0.02, -0.003, 0.03], [0.02, 0.003, 0.03], [0.024, -0.003, 0.03], [0.024, 0.003, 0.03]])
    tooth_m = slot_m + np.array([1e-3 * x_mm, 0.0, 0.0])
    tooth_m[:, 2] = CEILING_Z_M + 1e-3 * z_mm
    return {"key1_pts_m": tooth_m, "key2_pts_m": tooth_m - [0.016, 0.0, 0.0], "lock1_pts_m": slot_m}


def test_key_deep_in_the_lock_is_pulled_out_as_fast_as_allowed() -> None:
    action = out_and_up({}, info(-12.0, -0.1))
    assert action[0] == pytest.approx(-1.0)
    assert -1.0 < action[1] < 0.0


def test_key_below_its_slot_is_only_lifted() -> None:
    action = out_and_up({}, info(0.0, -0.1))
    assert action == pytest.approx([0.0, -1.0], abs=1e-6)


def test_lift_ends_half_a_millimetre_above_where_the_lock_opens() -> None:
    opening_mm = 1e3 * (SUCCESS_Z_RANGE_M[0] - CEILING_Z_M)
    assert out_and_up({}, info(0.0, opening_mm + 0.5)) == pytest.approx([0.0, 0.0], abs=1e-5)
    assert out_and_up({}, info(0.0, opening_mm + 0.25))[1] == pytest.approx(-0.25, abs=1e-5)


def test_place_of_the_rear_tooth_is_told_from_its_slot() -> None:
    assert PERSPECTIVE.position(info(-1.25, 0.5)) == "rear tooth from its slot x −1.25 mm, z +0.50 mm"


def test_heights_are_those_of_both_teeth_above_the_ceiling() -> None:
    progress = PERSPECTIVE.progress
    assert progress.heights_mm(info(0.0, 2.0)) == pytest.approx([2.0] * 8)
    assert progress.goal_mm == pytest.approx(1e3 * (SUCCESS_Z_RANGE_M[0] - CEILING_Z_M))
    assert not progress.goal_is_below


GOLDEN_START = LockStart(
    shape=KeyShape.KEY3,
    offset=KeyOffset(x_mm=2.7856902510311317, y_mm=0.0, z_mm=0.0),
    jitter=SensorJitter(x_mm=1.6018161737839443, z_mm=1.9130276349506772),
)


ENV = LockOpeningEnv()


def start(options: dict[str, Any], seed: int = 0) -> LockStart:
    return ENV.choose_start(options, np.random.default_rng(seed), ENV.settings)


def test_given_start_is_taken_and_draws_nothing() -> None:
    random = np.random.default_rng(0)
    options = {"shape": "key3", "offset_mm": (4.75, 0, 0), "sensor_jitter_mm": (-1.5, 0.25)}
    chosen = ENV.choose_start(options, random, ENV.settings)
    assert chosen.shape is KeyShape.KEY3
    assert chosen.offset == KeyOffset(x_mm=4.75, y_mm=0.0, z_mm=0.0)
    assert chosen.jitter == SensorJitter(x_mm=-1.5, z_mm=0.25)
    assert random.bit_generator.state == np.random.default_rng(0).bit_generator.state


def test_random_starts_cover_keys_offsets_and_jitter() -> None:
    drawn = [start({}, seed) for seed in range(400)]
    assert {chosen.shape for chosen in drawn} == set(KeyShape)
    x_mm = [chosen.offset.x_mm for chosen in drawn]
    assert 0 <= min(x_mm) < 0.2 < 4.8 < max(x_mm) < 5
    assert {(chosen.offset.y_mm, chosen.offset.z_mm) for chosen in drawn} == {(0.0, 0.0)}
    for values in ([chosen.jitter.x_mm for chosen in drawn], [chosen.jitter.z_mm for chosen in drawn]):
        assert -2 < min(values) < -1.9
        assert 1.9 < max(values) < 2
        assert np.mean(values) == pytest.approx(0.0, abs=0.2)


def test_jitter_of_a_listed_episode_comes_from_the_generator() -> None:
    options = {"shape": "key1", "offset_mm": (1.0, 0.0, 0.0)}
    assert start(options, 3) == start(options, 3)
    assert start(options, 3).jitter != start(options, 4).jitter


@pytest.mark.parametrize("shape", ["key5", 1, "cuboid"])
def test_unknown_key_is_refused(shape: Any) -> None:
    with pytest.raises(ResetOptionsError, match="expected one of key1, key2, key3, key4"):
        start({"shape": shape})


@pytest.mark.parametrize(
    "offset", [(1, 2), 3, "abc", (-1.5, 0, 0), (41, 0, 0), (0, 0.9, 0), (0, 0, -0.9), (0, 0, None)]
)
def test_offset_that_does_not_fit_the_channel_is_refused(offset: Any) -> None:
    with pytest.raises(ResetOptionsError, match=r"'offset_mm' is .*expected \(x, y, z\) in mm with -1\.4 <= x <= 40"):
        start({"offset_mm": offset})


@pytest.mark.parametrize("jitter", [(1, 2, 3), 1.0, (4.1, 0), (0, float("inf")), ("a", "b")])
def test_unusable_jitter_is_refused(jitter: Any) -> None:
    with pytest.raises(ResetOptionsError, match=r"'sensor_jitter_mm' is .*within 4 either way"):
        start({"sensor_jitter_mm": jitter})


def test_golden_random_starts_are_pinned() -> None:
    """The draws of a random start belong to the evaluator version."""
    random = np.random.Generator(np.random.PCG64(np.random.SeedSequence([0, 1])))
    assert ENV.choose_start({}, random, ENV.settings) == GOLDEN_START
