"""The moving hole on a stand-in for the physics: paths of the plate, and what is commanded and told while it moves."""

import pickle
from collections import Counter
from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from unpacked_files import unpack
from vitac.envs.drawing.playback import record
from vitac.envs.playback_files.scene import pack_scene
from vitac.envs.tasks.moving_hole.env import MovingHoleEnv, PlateMotion, PlatePath, to_where_the_hole_will_be
from vitac.envs.tasks.settings import ResetOptionsError

START = {"shape": "cuboid", "offset_mm_deg": (3.0, -2.0, 5.0), "rng_seed": (0, 1)}
STEADY = {"plate_motion": "constant", "plate_direction_deg": 90.0, "plate_start_s": 0.6}


def played(*actions: list[float], **settings: Any) -> tuple[Any, ...]:
    env = MovingHoleEnv(**settings)
    result: tuple[Any, ...] = env.reset(options={**START, **STEADY})
    for action in actions:
        result = env.step(np.array(action, dtype=np.float32))
    return env, *result


@pytest.mark.parametrize(
    ("motion", "time_s", "along_mm"),
    [
        ("constant", 0.9, 0.0),
        ("constant", 3.0, 4.0),
        ("conveyor", 2.2, 2.4),
        ("conveyor", 2.9, 2.4),
        ("conveyor", 3.5, 2.4 + 1.0),
        ("sine", 2.5, 6.0 / np.pi),  # a quarter of its period
        ("sine", 7.0, 0.0),
    ],
)
def test_plate_is_on_its_line_as_far_as_its_motion_says(motion: str, time_s: float, along_mm: float) -> None:
    path = PlatePath(motion=PlateMotion(motion), speed_mm_s=2.0, direction_deg=60.0, start_s=1.0)
    expected = along_mm * np.array([0.5, np.sqrt(3.0) / 2.0, 0.0])
    assert 1e3 * path(time_s) == pytest.approx(expected, abs=1e-12)
    assert pickle.loads(pickle.dumps(path)) == path  # noqa: S301 - our own


def test_every_ipc_step_has_the_plate_where_its_path_is(physics: list[FakeScene]) -> None:
    env, *_ = played([0.0, 0.0, 0.0], plate_speed_mm_s=1.0)
    given = [displacements[1] * 1e3 for displacements in physics[0].displacements_m]
    assert env.ipc_steps == len(given) == 8
    assert np.array(given)[:, 1] == pytest.approx([0.0] * 6 + [0.1, 0.2], abs=1e-12)
    assert not np.array(given)[:, [0, 2]].round(12).any()


def test_offset_is_from_the_hole_and_motion_in_the_world(physics: list[FakeScene]) -> None:
    _, observation, _, _, _, info = played([0.0, 0.0, 0.0], [0.5, 0.0, 0.0], plate_speed_mm_s=1.0)
    moved = np.array([np.cos(np.radians(5.0)), np.sin(np.radians(5.0))])
    assert info["plate_mm"] == pytest.approx([0.0, 0.6])
    assert info["plate_step_mm"] == pytest.approx([0.0, 0.4])
    assert info["gt_offset_mm_deg"] == pytest.approx([3.0 + moved[0], -2.0 + moved[1] - 0.6, 5.0])
    assert observation["relative_motion"] == pytest.approx([*moved, 0.0, -0.16], abs=1e-6)
    gripper = np.mean([np.mean(targets, axis=0) for targets in physics[0].targets_m[-1]], axis=0) * 1e3
    assert gripper[:2] == pytest.approx([3.0 + moved[0], -2.0 + moved[1]]), "in the world"
    assert gripper[2] == pytest.approx(20.1 + 50.0 - 8.0 - 0.18 - 0.16)


def test_truth_is_told_to_nobody_but_the_expert_who_meets_the_hole() -> None:
    env = MovingHoleEnv(plate_speed_mm_s=2.0)
    observation, info = env.reset(options={**START, **STEADY})
    assert set(observation) == {"marker_flow", "relative_motion"}
    for _ in range(4):
        _, _, _, _, info = env.step(to_where_the_hole_will_be(observation, info))
    assert info["gt_offset_mm_deg"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-5)
    assert np.linalg.norm(info["plate_mm"]) > 2.0


def test_what_the_options_leave_open_follows_from_the_seed() -> None:
    env: Any = MovingHoleEnv(draws={"plate_speed_mm_s": (0.4, 1.4)})
    paths = []
    for number in range(40):
        env.reset(options={"rng_seed": (0, number)})
        paths.append(env.task_scene.path)
    env.reset(options={"rng_seed": (0, 39)})
    assert env.task_scene.path == paths[-1]
    assert set(Counter(path.motion for path in paths)) == set(PlateMotion)
    assert 0.4 <= min(path.start_s for path in paths) < max(path.start_s for path in paths) <= 2.0
    assert 0.4 <= min(path.speed_mm_s for path in paths) < max(path.speed_mm_s for path in paths) <= 1.4
    env.reset(options={"rng_seed": (0, 39), "plate_motion": "sine"})
    assert env.task_scene.path.direction_deg == paths[-1].direction_deg


@pytest.mark.parametrize("option", [{"plate_motion": "zigzag"}, {"plate_start_s": "soon"}])
def test_a_path_that_is_none_is_refused(option: dict[str, Any]) -> None:
    with pytest.raises(ResetOptionsError, match=f"ViTac/MovingHole-v1: option '{next(iter(option))}'"):
        MovingHoleEnv().reset(options=option)


def test_playback_rides_on_the_plate_and_knows_how_far() -> None:
    env = MovingHoleEnv(plate_speed_mm_s=2.0, max_steps=2)
    playback = record(env, options={**START, **STEADY}, next_action=lambda *_: np.zeros(3, dtype=np.float32))
    centres = [np.mean([pose.centre_m for pose in moment.sensor_poses], axis=0) for moment in playback.moments]
    assert 1e3 * (centres[-1] - centres[0])[:2] == pytest.approx([0.0, -1.2])
    assert unpack(pack_scene(playback)).arrays["fixed_shifts_mm"][:, 1] == pytest.approx([0.0, 0.4, 1.2])
