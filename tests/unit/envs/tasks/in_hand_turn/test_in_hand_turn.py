"""The turn in the hand on a stand-in for the physics, where a rod moves with the gripper and never turns in it."""

from typing import Any

import numpy as np
import pytest
from fake_scene import FakeScene
from vitac.envs.fem.scene.report import StepStatus
from vitac.envs.tactile.gel import GelDimensions
from vitac.envs.tasks.in_hand_turn.env import DRAWN, InHandTurnEnv, RodShape, edge_mesh, press_until_it_stays, rod_mesh
from vitac.envs.tasks.settings import ResetOptionsError, SettingsError

START = (3.0, -6.0, 20.0)
PRESS, REST = [1.0, 0.0], [0.0, 0.0]


def played(*actions: list[float], start: tuple[float, ...] = START, **settings: Any) -> tuple[Any, ...]:
    env = InHandTurnEnv(**settings)
    result: tuple[Any, ...] = env.reset(options={"shape": "narrow", "start_mm_deg": start, "rng_seed": (0, 1)})
    for action in actions:
        result = env.step(np.array(action, dtype=np.float32))
    return env, *result


@pytest.mark.parametrize("shape", list(RodShape))
@pytest.mark.parametrize(("angle_deg", "held_mm"), [(-6.0, 4.0), (0.0, 0.0), (12.0, -3.0)])
def test_rod_starts_at_its_angle_and_as_far_from_the_edge_as_asked(
    shape: str, angle_deg: float, held_mm: float
) -> None:
    env = InHandTurnEnv(held_mm=held_mm)
    _, info = env.reset(options={"shape": shape, "start_mm_deg": (2.0, angle_deg, 20.0)})
    vertices_m = env.scene.held_vertices_m(np.arange(len(rod_mesh(RodShape(shape)).vertices_m)))
    slope = np.tan(np.radians(angle_deg))
    # Below its head the rod's flank towards the edge is the line with the largest x at the height of the edge.
    lower_m = vertices_m[vertices_m[:, 2] < -0.02]
    assert (lower_m[:, 0] - slope * lower_m[:, 2]).max() == pytest.approx(-2e-3, abs=1e-9)
    assert info["angle_deg"] == pytest.approx(angle_deg)
    assert info["gap_mm"] == pytest.approx(2.0)
    assert info["edge_mm"][1] == pytest.approx(-24.0 - held_mm)


def test_head_covers_the_gels_at_any_angle_wherever_it_is_held() -> None:
    """What slides over a gel is a plane: no edge of the rod comes near the face between the bevels."""
    size = GelDimensions()
    half_mm = 0.5 * np.array([size.width_mm, size.length_mm]) - size.bevel_inset_mm
    reach_mm = np.hypot(*half_mm)
    rod_mm = 1e3 * rod_mesh(RodShape.NARROW).vertices_m
    outline = np.unique(rod_mm[rod_mm[:, 2] > -17.5][:, [0, 2]], axis=0)
    centre = outline.mean(axis=0)
    ordered = outline[np.argsort(np.arctan2(*(outline - centre).T))]
    for held_mm in (-4.0, 0.0, 4.0):
        for first, second in zip(ordered, np.roll(ordered, -1, axis=0), strict=True):
            along = (second - first) / np.linalg.norm(second - first)
            away = np.array([0.0, held_mm]) - first
            assert abs(along[0] * away[1] - along[1] * away[0]) > reach_mm


def test_bar_passes_between_the_gels() -> None:
    assert np.abs(edge_mesh().vertices_m[:, 1]).max() < 4e-3 - 1e-3


def test_gripper_withdraws_from_the_edge_after_the_last_env_step_alone() -> None:
    env, _, _, _, _, info = played(PRESS, PRESS, max_steps=3)
    assert info["relative_motion_mm"] == pytest.approx([10.0, 0.0])
    *_, terminated, truncated, info = env.step(np.array([0.5, -1.0], dtype=np.float32))
    assert info["relative_motion_mm"] == pytest.approx([10.0 + 2.5 - 12.0, -2.0])
    assert (terminated, truncated, info["end_reason"]) == (False, True, "steps")


@pytest.mark.parametrize(("goal_deg", "end"), [(-5.6, "success"), (-5.4, "steps")])
def test_success_is_an_angle_within_its_tolerance_of_the_goal_at_the_very_end(goal_deg: float, end: str) -> None:
    env, *_, info = played(REST, start=(3.0, -6.0, goal_deg), max_steps=2)
    assert (info["end_reason"], info["is_success"]) == (None, False)
    _, reward, terminated, truncated, info = env.step(np.zeros(2, dtype=np.float32))
    assert info["end_reason"] == end
    assert (terminated, truncated) == (end == "success", end != "success")
    assert reward == pytest.approx(10.0 if end == "success" else 0.0)
    assert info["angle_error_deg"] == pytest.approx(abs(goal_deg + 6.0))


def test_sensing_surface_that_moved_too_far_ends_the_episode_and_the_gripper_withdraws(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    env, *_ = played(PRESS)
    monkeypatch.setattr(FakeScene, "bulge_m", 2e-3)
    *_, info = env.step(np.array(PRESS, dtype=np.float32))
    assert info["end_reason"] == "tactile"
    assert info["relative_motion_mm"] == pytest.approx([10.0 - 12.0, 0.0])


@pytest.mark.parametrize("up", [1.0, -1.0])
def test_gripper_may_rise_or_sink_by_eight_millimetres(up: float) -> None:
    env, *_, info = played(*[[0.0, up]] * 4)
    assert info["end_reason"] is None
    *_, truncated, info = env.step(np.array([0.0, up], dtype=np.float32))
    assert (truncated, info["end_reason"], info["error_too_large"]) == (True, "error", True)


def test_rod_that_was_not_freed_counts_as_it_was_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    env, *_ = played(PRESS, PRESS, max_steps=3)
    # Nothing moves after an IPC step that did not converge: the rod stays pressed, however near to its goal it is.
    monkeypatch.setattr("vitac.envs.tasks.in_hand_turn.env.InHandTurnScene.angle_deg", lambda _: 20.0)
    env.scene._scene._pending = [StepStatus.NOT_CONVERGED]
    *_, info = env.step(np.array(PRESS, dtype=np.float32))
    assert info["end_reason"] == "not_converged"
    assert (info["angle_deg"], info["angle_error_deg"]) == (20.0, pytest.approx(26.0))


def test_policy_is_told_the_goal_and_not_the_angle() -> None:
    _, observation, _ = played()
    assert set(observation) == {"goal_angle", "relative_motion", "marker_flow"}
    assert observation["goal_angle"] == pytest.approx([20.0])
    _, observation, _ = played(privileged=True)
    assert observation["rod_angle"] == pytest.approx([-6.0])
    assert observation["surface_pts"].shape == (2, 2, 81, 3)


def test_gels_that_turn_with_the_rod_are_seen_as_twisted(monkeypatch: pytest.MonkeyPatch) -> None:
    env, *_ = played()
    points = env.scene.surface_points_m()
    assert env.task_scene.twist_deg() == 0.0
    sine, cosine = np.sin(np.radians(5.0)), np.cos(np.radians(5.0))
    for points_m, right in zip(points, (-1.0, 1.0), strict=True):
        # In the camera's frame x is up; y is along the world's x axis for the right sensor, against it for the left.
        up, along = points_m[0, :, 0], right * points_m[0, :, 1]
        points_m[1, :, 0], points_m[1, :, 1] = cosine * up - sine * along, right * (cosine * along + sine * up)
    monkeypatch.setattr(type(env.scene), "surface_points_m", lambda _: points)
    assert env.task_scene.twist_deg() == pytest.approx(5.0, rel=2e-3)


def test_what_the_options_leave_open_follows_from_the_seed_and_is_a_turn_worth_making() -> None:
    env: Any = InHandTurnEnv()
    starts, shapes = [], set()
    for number in range(30):
        _, info = env.reset(options={"rng_seed": (0, number)})
        starts.append((info["gap_mm"], info["angle_deg"], info["goal_deg"]))
        shapes.add(env.task_scene.shape)
    _, info = env.reset(options={"rng_seed": (0, 29)})
    assert (info["gap_mm"], info["angle_deg"], info["goal_deg"]) == starts[-1]
    assert shapes == set(RodShape)
    for values, (low, high) in zip(np.transpose(starts), DRAWN, strict=True):
        assert low <= values.min() < values.max() <= high
    assert min(goal - angle for _, angle, goal in starts) > 2 * env.settings.tolerance_deg


def test_expert_goes_to_the_edge_and_does_not_press_what_would_stay_at_its_goal() -> None:
    info = {"angle_deg": 26.0, "twist_deg": 6.0, "goal_deg": 26.0 - 0.92 * 6.0, "gap_mm": 0.0, "edge_mm": [3.0, -24.0]}
    assert press_until_it_stays({}, info) == pytest.approx([0.0, 0.0], abs=1e-6)
    assert press_until_it_stays({}, {**info, "goal_deg": 15.0}).tolist() == [0.0, 0.0]
    assert press_until_it_stays({}, {**info, "goal_deg": 24.0})[0] > 0.0
    assert press_until_it_stays({}, {**info, "gap_mm": 10.0}).tolist() == [1.0, 0.0]


@pytest.mark.parametrize("start", [(0.1, 0.0, 20.0), (3.0, 16.0, 20.0), (3.0, 0.0, 50.0), (3.0, 0.0)])
def test_a_start_that_is_none_is_refused(start: tuple[float, ...]) -> None:
    with pytest.raises(
        ResetOptionsError, match=r"start_mm_deg.*expected \(gap mm, angle deg, goal deg\) of 0\.2 to 30"
    ):
        InHandTurnEnv().reset(options={"start_mm_deg": start})


@pytest.mark.parametrize(
    ("setting", "value"), [("held_mm", 5.0), ("tolerance_deg", 0.0), ("action_scale_mm", (1.0,)), ("max_steps", 0)]
)
def test_a_setting_out_of_range_is_refused(setting: str, value: Any) -> None:
    with pytest.raises(SettingsError, match=setting):
        InHandTurnEnv(**{setting: value})
