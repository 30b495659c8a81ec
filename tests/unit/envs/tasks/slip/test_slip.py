"""The slip task on a stand-in for the physics: what is commanded, weighed, loaded, judged and told."""

import pickle
from collections import Counter
from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from unpacked_files import unpack
from vitac.envs.drawing.playback import record
from vitac.envs.playback_files.scene import pack_scene
from vitac.envs.tasks.settings import ResetOptionsError, SettingsError
from vitac.envs.tasks.slip.env import GrowingLoad, SlipEnv, SlipScene, lift_ever_harder

START = {"shape": "bar", "offset_mm": (1.0, -2.0), "rng_seed": (0, 1)}


def played(*actions: tuple[float, float], **settings: Any) -> tuple[Any, ...]:
    env = SlipEnv(**settings)
    result: tuple[Any, ...] = env.reset(options=START)
    for action in actions:
        result = env.step(np.array(action, dtype=np.float32))
    return env, *result


def test_action_sets_height_and_width_of_the_gripper(physics: list[FakeScene]) -> None:
    _, observation, _, _, _, info = played((0.5, -1.0), (1.0, -0.5))
    assert observation["relative_motion"] == pytest.approx([1.5])
    assert observation["gripper_width"] == pytest.approx([30.16 - 0.3])
    assert info["gripper_width_mm"] == pytest.approx(30.16 - 0.3)
    backs = [np.mean(targets, axis=0) * 1e3 for targets in physics[0].targets_m[-1]]
    grasp = [np.mean(targets, axis=0) * 1e3 for targets in physics[0].targets_m[1]]
    assert np.array(backs) - grasp == pytest.approx(np.array([[0.0, -0.15, 1.5], [0.0, 0.15, 1.5]]))


def test_part_weighs_what_was_drawn_and_is_pulled_where_its_centre_of_mass_is(physics: list[FakeScene]) -> None:
    played(*[(0.0, 0.0)] * 12, part_mass_kg=0.3, centre_of_mass_mm=2.0, load_n=9.0)
    part = physics[0].bodies[0]
    (inside,) = part.point_masses
    masses = [part.density_kg_m3 * part.mesh.volume_m3, inside.mass_kg]
    centre = (masses[0] * part.mesh.moments[1] / part.mesh.volume_m3 + masses[1] * inside.point_m) / sum(masses)
    assert sum(masses) == pytest.approx(0.3)
    assert 1e3 * centre == pytest.approx([2.0, 0.0, 25.0])
    assert physics[0].gravity_m_s2 == (0.0, 0.0, -9.81)
    pulls = [loads[0] for loads in physics[0].loads]
    assert [-pull.force_n[2] for pull in pulls] == pytest.approx([0.0] * 9 + [1.0, 2.0, 3.0, 4.0, 5.0])
    assert 1e3 * pulls[-1].point_m == pytest.approx([2.0, 0.0, 25.0])


def test_load_grows_evenly_and_can_be_pickled() -> None:
    load = GrowingLoad(first_s=1.0, last_s=3.0, force_n=8.0, point_mm=(0.0, 0.0, 25.0))
    assert [load.at(time_s) for time_s in (0.0, 1.5, 2.0, 9.0)] == [0.0, 2.0, 4.0, 8.0]
    assert pickle.loads(pickle.dumps(load)) == load  # noqa: S301 - our own


def test_a_jaw_that_presses_too_hard_crushes_the_part() -> None:
    # The stand-in's jaws press with 5 N.
    *_, truncated, info = played((0.0, 0.0), part_mass_kg=0.5, load_n=1.7)
    assert info["largest_grip_n"] == pytest.approx(1.5 * (0.5 * 9.81 + 1.7) / 2.0)
    assert (truncated, info["crushed"], info["end_reason"]) == (True, True, "force")
    *_, info = played((0.0, 0.0), part_mass_kg=0.5, load_n=1.8)
    assert (info["grip_force_n"], info["crushed"]) == (5.0, False)


def test_a_part_that_stands_while_the_load_grows_is_no_success() -> None:
    *_, truncated, info = played(*[(0.0, 0.0)] * 7)
    assert not truncated
    *_, truncated, info = played(*[(0.0, 0.0)] * 8)
    assert (truncated, info["error_too_large"], info["end_reason"]) == (True, True, "error")


def test_a_part_that_slides_down_in_the_grasp_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SlipScene, "_height_in_grasp_m", lambda scene: -1e-3 * 1.6 * scene.grasped.ipc_steps)
    *_, info = played((1.0, 0.0))
    assert (info["error_too_large"], info["end_reason"]) == (True, "error")


def test_part_that_stands_is_set_down_once_it_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    env = SlipEnv(load_first_step=2, load_last_step=2)
    env.reset(options=START)
    for action in ((1.0, 0.0), (0.0, 0.0)):
        *_, info = env.step(np.array(action, dtype=np.float32))
    assert (info["end_reason"], info["mean_grip_force_n"]) == (None, 5.0)
    *_, terminated, _, info = env.step(np.array([-1.0, 0.0], dtype=np.float32))
    assert (terminated, info["heights_mm"].max() < 0.2) == (False, True), "it is held"
    monkeypatch.setattr("vitac.envs.scene.grasped_scene.GraspedScene.grip_force_n", lambda _: 0.0)
    *_, terminated, _, info = env.step(np.array([0.0, 1.0], dtype=np.float32))
    assert (terminated, info["end_reason"]) == (True, "success")
    assert info["mean_grip_force_n"] == 5.0, "of the env steps in which the load grows"


def test_truth_is_told_to_nobody_but_the_expert() -> None:
    env = SlipEnv()
    observation, info = env.reset(options=START)
    assert set(observation) == {"marker_flow", "relative_motion", "gripper_width"}
    standing = info | {"grip_force_n": 0.75, "needed_grip_n": 3.0, "steps": 2}
    assert lift_ever_harder(observation, standing) == pytest.approx([0.6, -(1.5**2 - 0.75) / 30.0 / 0.2])
    hanging = standing | {"heights_mm": np.array([0.5, 0.5, 0.6, 0.6])}
    assert lift_ever_harder(observation, hanging) == pytest.approx([0.0, -(3.75 - 0.75) / 30.0 / 0.2])
    assert lift_ever_harder(observation, hanging | {"grip_force_n": 4.0}) == pytest.approx([1.0, 0.0])


def test_what_the_options_leave_open_follows_from_the_seed() -> None:
    env: Any = SlipEnv(draws={"load_n": (4.0, 14.0), "gel_friction": (0.4, 1.2)})
    shapes, properties = [], []
    for number in range(20):
        env.reset(options={"rng_seed": (0, number)})
        shapes.append(env.task_scene.shape)
        properties.append(env.task_scene.properties())
    env.reset(options={"rng_seed": (0, 19)})
    assert (env.task_scene.properties() == properties[-1]).all()
    assert set(Counter(shapes)) == {"block", "bar", "column"}
    low, high = np.min(properties, axis=0), np.max(properties, axis=0)
    assert 0.4 <= low[2] < high[2] <= 1.2
    assert 4.0 <= low[3] < high[3] <= 14.0


@pytest.mark.parametrize("option", [{"shape": "ball"}, {"offset_mm": (0.0, 11.0)}, {"offset_mm": (1.0,)}])
def test_a_start_that_is_none_is_refused(option: dict[str, Any]) -> None:
    with pytest.raises(ResetOptionsError, match=f"ViTac/Slip-v1: option '{next(iter(option))}'"):
        SlipEnv().reset(options=option)


@pytest.mark.parametrize(
    ("name", "value"),
    [("touching_width_mm", 31.0), ("crush_ratio", 1.0), ("load_first_step", 17), ("part_mass_kg", 2.0)],
)
def test_a_setting_out_of_range_is_refused(name: str, value: Any) -> None:
    with pytest.raises(SettingsError, match=name):
        SlipEnv(**{name: value})


def test_playback_has_the_width() -> None:
    env = SlipEnv(max_steps=2)
    playback = record(env, options=START, next_action=lambda *_: np.array([0.0, -1.0], dtype=np.float32))
    poses_mm = unpack(pack_scene(playback)).arrays["sensor_poses"]
    apart_mm = np.linalg.norm(poses_mm[:, 0, 9:] - poses_mm[:, 1, 9:], axis=1)
    assert apart_mm[0] - apart_mm == pytest.approx([0.0, 0.2, 0.4], abs=0.011)


def test_failing_before_the_load_grows_does_not_count_as_a_light_grip() -> None:
    *_, info = played(*[(0.0, 0.0)] * 8)
    assert info["end_reason"] == "error"
    assert info["mean_grip_force_n"] == pytest.approx((8 * info["largest_grip_n"] + 5.0) / 9)
