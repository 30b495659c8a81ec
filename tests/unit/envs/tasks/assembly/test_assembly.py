"""The assembly on a stand-in for the physics: what is commanded, weighed, judged by stages and told."""

from collections import Counter
from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from unpacked_files import unpack
from vitac.envs.drawing.playback import record
from vitac.envs.playback_files.scene import pack_scene
from vitac.envs.tasks.assembly.definition import STAGES
from vitac.envs.tasks.assembly.env import AssemblyEnv, AssemblyScene, fetch_insert_and_turn
from vitac.envs.tasks.settings import ResetOptionsError, SettingsError

START = {"shape": "narrow", "offset_mm_deg": (0.0, 0.0, 0.0), "rng_seed": (0, 1)}
# What the part, which hangs 0.1 mm above the tray here, is lifted by, carried by and put in by.
LIFT, CARRY, LOWER = (0, 0, 1, 0, 0), (1, 0, 0, 0, 0), (0, 0, -1, 0, 0)


def played(*actions: tuple[float, ...], start: dict[str, Any] | None = None, **settings: Any) -> tuple[Any, ...]:
    env = AssemblyEnv(**settings)
    result: tuple[Any, ...] = env.reset(options=start or START)
    for action in actions:
        result = env.step(np.array(action, dtype=np.float32))
    return env, *result


def test_action_moves_turns_and_closes_the_gripper() -> None:
    _, observation, *_, info = played((0.5, -1.0, 0.25, 0.5, -1.0), (0.5, 2.0, 0.25, 0.5, -0.5))
    assert observation["relative_motion"] == pytest.approx([6.0, 0.0, 1.5, 6.0])
    assert info["relative_motion_mm_deg"] == pytest.approx([6.0, 0.0, 1.5, 6.0])
    assert observation["gripper_width"] == pytest.approx([36.0 - 3.0])


def test_gripper_stops_above_the_plate_and_has_left_its_range_there() -> None:
    env, *_, info = played(LOWER, LOWER, (0, 0, -0.5, 0, 0))
    assert info["end_reason"] is None
    *_, info = env.step(np.array(LOWER, dtype=np.float32))
    assert (info["relative_motion_mm_deg"][2], info["end_reason"]) == (pytest.approx(-10.0), "error")


def test_part_stands_in_the_tray_as_the_options_say_and_its_weight_is_low(physics: list[FakeScene]) -> None:
    start = {**START, "offset_mm_deg": (3.0, -0.5, 7.0)}
    env, _, info = played(start=start, part_mass_kg=0.1)
    assert info["offset_mm_deg"] == pytest.approx([3.0 - 26.0, -0.5, 0.1 - 3.0, 7.0])
    part = physics[0].bodies[0]
    (inside,) = part.point_masses
    spread_kg = part.density_kg_m3 * part.mesh.volume_m3
    assert spread_kg + inside.mass_kg == pytest.approx(0.1)
    centre_m = (spread_kg * part.mesh.moments[1] / part.mesh.volume_m3 + inside.mass_kg * inside.point_m) / 0.1
    assert 1e3 * centre_m[2] < 7.0
    assert physics[0].gravity_m_s2 == (0.0, 0.0, -9.81)
    assert env.task_scene.stage == 0


def test_stages_follow_each_other_and_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    env, *_ = played()
    stages = []
    for action in (LIFT, LIFT, *[CARRY] * 4, (1 / 3, 0, 0, 0, 0), (0, 0, -0.8, 0, 0), LOWER, LOWER, LOWER, LIFT):
        *_, info = env.step(np.array(action, dtype=np.float32))
        stages.append(info["stage"])
    assert stages == [0, 1, 1, 1, 1, 1, 1, 2, 2, 2, 3, 3]
    below_mm = env.task_scene.heights_mm().max() + 7.0
    assert below_mm > 0, "it is no more inserted, and was"
    env.step(np.array(LOWER, dtype=np.float32))
    for turn_deg, ended in ((56.9, None), (57.0, "success")):
        offset = np.array([0.0, 0.0, -8.0, turn_deg])
        monkeypatch.setattr(AssemblyScene, "offset_mm_deg", lambda _, offset=offset: offset)
        *_, info = env.step(np.array((0, 0, 0, 0, 0), dtype=np.float32))
        assert info["end_reason"] == ended
    assert (info["stage"], info["is_success"]) == (4, True)


def test_what_is_over_the_opening_is_aligned_only_within_its_outline() -> None:
    carried = [LIFT, LIFT, *[CARRY] * 4, (1 / 3, 0, 0, 0, 0), (0, 0, -0.8, 0, 0)]
    for start, stage in (((0.6, 0.0, 0.0), 2), ((0.8, 0.0, 0.0), 1), ((0.0, 0.0, 4.0), 2), ((0.0, 0.0, 5.0), 1)):
        *_, info = played(*carried, start={**START, "offset_mm_deg": start})
        assert info["stage"] == stage, start


def test_what_is_low_beside_the_socket_is_not_inserted() -> None:
    *_, info = played(LOWER, LOWER)
    assert info["offset_mm_deg"][2] < -7.0
    assert info["stage"] == 0


def test_turned_in_the_air_nothing_locks() -> None:
    *_, info = played(LIFT, LIFT, *[(0, 0, 0, 1, 0)] * 12)
    assert (info["stage"], info["end_reason"]) == (1, None)


@pytest.mark.parametrize(
    ("action", "within"),
    [((-1, 0, 0, 0, 0), 2), ((0, 1, 0, 0, 0), 2), ((0, 0, -1, 0, 0), 2), ((0, 0, 0, -1, 0), 6), ((0, 0, 0, 1, 0), 15)],
)
def test_gripper_may_go_to_the_end_of_its_range_and_not_beyond(action: tuple[float, ...], within: int) -> None:
    *_, info = played(*[action] * within)
    assert info["end_reason"] is None
    *_, info = played(*[action] * (within + 1))
    assert (info["end_reason"], info["error_too_large"]) == ("error", True)


@pytest.mark.parametrize("heights_mm", [(0.0, 5.1), (-12.1, -12.1)])
def test_part_that_falls_over_or_off_ends_the_episode(
    heights_mm: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(AssemblyScene, "heights_mm", lambda _: np.array(heights_mm))
    *_, truncated, info = played(LIFT)
    assert (truncated, info["end_reason"]) == (True, "error")


def test_reward_counts_the_stages_and_their_parts() -> None:
    env, *_ = played()
    rewards = []
    for action in (LIFT, LIFT, *[CARRY] * 4):
        _, reward, *_ = env.step(np.array(action, dtype=np.float32))
        rewards.append(reward)
    assert all(reward > 0 for reward in rewards)
    assert 10.0 < sum(rewards) < 20.0


def test_episode_without_an_env_step_has_reached_no_stage() -> None:
    *_, info = played(LIFT, LIFT)
    assert STAGES.read_end(info) == 1.0
    assert STAGES.read_end(None) == 0.0


def test_truth_is_told_to_nobody_but_the_expert() -> None:
    env = AssemblyEnv()
    observation, info = env.reset(options={**START, "offset_mm_deg": (2.0, 0.5, 3.0)})
    assert set(observation) == {"marker_flow", "relative_motion", "gripper_width"}
    action = fetch_insert_and_turn(observation, info | {"grip_force_n": 0.0})
    assert action == pytest.approx([0.0, 0.0, 0.0, 0.0, -1.0], abs=1e-6), "it closes where it is"


@pytest.mark.parametrize(
    ("offset_mm_deg", "grip_force_n", "expected"),
    [
        ((-6.0, 0.0, 1.2, 0.0), 20.0, [1.0, 0.0, 0.0, 0.0, 0.0]),
        ((-6.0, 0.0, 1.2, 0.0), 11.0, [1.0, 0.0, 0.0, 0.0, -0.1]),
        ((-2.0, 0.0, 0.0, 0.0), 20.0, [1 / 3, 0.0, -1 / 30, 0.0, 0.0]),
        ((-0.2, 0.0, 0.0, 0.0), 20.0, [1 / 78, 0.0, -1.0, 0.0, 0.0]),
        ((-0.6, 0.0, -1.8, 0.0), 20.0, [1 / 20, 0.0, -1.0, 0.0, 0.0]),
        ((0.0, 0.0, -7.8, 12.0), 20.0, [0.0, 0.0, 0.0, 1.0, 0.0]),
    ],
    ids=["carries", "grips again", "slides over the rim", "lowers", "goes on in the opening", "turns"],
)
def test_expert_does_what_the_place_of_the_part_asks_for(
    offset_mm_deg: tuple[float, ...], grip_force_n: float, expected: list[float]
) -> None:
    env = AssemblyEnv()
    observation, info = env.reset(options=START)
    offset = np.array(offset_mm_deg)
    info |= {"stage": 1, "offset_mm_deg": offset, "grip_force_n": grip_force_n}
    info["relative_motion_mm_deg"] = np.array([26.0 + offset[0], 0.0, 3.0, 0.0])
    assert fetch_insert_and_turn(observation, info) == pytest.approx(expected, abs=1e-6)


def test_what_the_options_leave_open_follows_from_the_seed() -> None:
    env: Any = AssemblyEnv()
    shapes, offsets = [], []
    for number in range(30):
        _, info = env.reset(options={"rng_seed": (0, number)})
        shapes.append(env.task_scene.shape)
        offsets.append(info["offset_mm_deg"] + [26.0, 0.0, 0.0, 0.0])
    _, info = env.reset(options={"rng_seed": (0, 29)})
    assert (info["offset_mm_deg"] + [26.0, 0.0, 0.0, 0.0] == offsets[-1]).all()
    assert set(Counter(shapes)) == {"narrow", "wide"}
    low, high = np.min(offsets, axis=0), np.max(offsets, axis=0)
    assert (low[[0, 1, 3]] > [-4.5, -1.0, -10.0]).all()
    assert (high[[0, 1, 3]] < [4.5, 1.0, 10.0]).all()
    assert (high - low)[[0, 1, 3]] == pytest.approx([9.0, 2.0, 20.0], rel=0.25)


@pytest.mark.parametrize("option", [{"shape": "ball"}, {"offset_mm_deg": (0.0, 1.1, 0.0)}, {"offset_mm_deg": (1.0,)}])
def test_a_start_that_is_none_is_refused(option: dict[str, Any]) -> None:
    with pytest.raises(ResetOptionsError, match=f"ViTac/Assembly-v1: option '{next(iter(option))}'"):
        AssemblyEnv().reset(options=option)


@pytest.mark.parametrize(
    ("name", "value"), [("max_steps", 0), ("part_mass_kg", 2.0), ("random_x_mm", 5.0), ("action_scale_mm_deg", (1.0,))]
)
def test_a_setting_out_of_range_is_refused(name: str, value: Any) -> None:
    with pytest.raises(SettingsError, match=name):
        AssemblyEnv(**{name: value})


def test_fidelity_for_training_keeps_the_solver_of_the_task() -> None:
    full, training = AssemblyEnv(), AssemblyEnv(fidelity="training")
    solvers = [env.settings.physics.solver for env in (full, training)]
    assert [solver.phase_iterations for solver in solvers] == [20, 20]
    assert solvers[1].residual_tolerance_n > solvers[0].residual_tolerance_n


def test_playback_has_the_gripper_as_it_closes_and_turns() -> None:
    env = AssemblyEnv(max_steps=2)
    playback = record(env, options=START, next_action=lambda *_: np.array([0, 0, 0, 1.0, -1.0], dtype=np.float32))
    poses_mm = unpack(pack_scene(playback)).arrays["sensor_poses"]
    apart_mm = np.linalg.norm(poses_mm[:, 0, 9:] - poses_mm[:, 1, 9:], axis=1)
    assert apart_mm[0] - apart_mm == pytest.approx([0.0, 2.0, 4.0], abs=0.011)
