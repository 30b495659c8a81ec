"""The exploring task on a stand-in for the physics: block and end, where touches are, and what answers score."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import trimesh
from fake_scene import FakeScene
from vitac.envs.tasks.explore.definition import BRIER, EndShape
from vitac.envs.tasks.explore.env import AROUND_MM, EndPose, ExploreEnv, block_mesh, touch_around
from vitac.envs.tasks.settings import ResetOptionsError
from vitac.evaluator.tracks import load_track

START = {"shape": "cross", "end_pose_mm_deg": (1.0, -2.0, 10.0), "rng_seed": (0, 1)}
AREA_MM2 = {"square": 256.0, "bar": 120.0, "beam": 120.0, "cross": 204.0, "frame": 156.0, "corner": 120.0}


def answer(x: float = 0.0, y: float = 0.0, **weights: float) -> np.ndarray:
    return np.array([x, y, *(weights.get(shape, -1.0) for shape in EndShape)], dtype=np.float32)


def played(*actions: np.ndarray, **options: Any) -> tuple[Any, ...]:
    env = ExploreEnv()
    result: tuple[Any, ...] = env.reset(options=START | options)
    for action in actions:
        result = env.step(action)
    return env, *result


@pytest.mark.parametrize("shape", list(EndShape))
def test_a_block_with_any_end_is_a_closed_solid_of_its_volume(shape: EndShape) -> None:
    mesh = block_mesh(shape, EndPose(x_mm=-3.0, y_mm=3.0, angle_deg=30.0))
    solid = trimesh.Trimesh(1e3 * mesh.vertices_m, mesh.triangles, process=False)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.volume == pytest.approx(40 * 30 * 40 + 10 * AREA_MM2[shape])
    assert solid.body_count == 1


def test_each_env_step_lifts_goes_and_touches(physics: list[FakeScene]) -> None:
    env, observation, *_, info = played(answer(1.0, -0.5), answer(-0.25, 0.0))
    assert observation["relative_motion"] == pytest.approx([6.0, -4.0])
    assert info["relative_motion_mm"] == pytest.approx([6.0, -4.0])
    gripper_mm = [1e3 * np.mean([np.mean(gel, axis=0) for gel in targets], axis=0) for targets in physics[0].targets_m]
    heights = np.round([place[2] for place in gripper_mm], 6)
    assert heights.min() == pytest.approx(heights.max() - 0.8)
    assert heights[-1] == heights.min()
    sideways = [np.abs(after - before)[:2].max() > 1e-6 for before, after in pairwise(gripper_mm)]
    lifted = [max(before[2], after[2]) == pytest.approx(heights.max()) for before, after in pairwise(gripper_mm)]
    assert all(up for moved, up in zip(sideways, lifted, strict=True) if moved), "it travels in the air"
    assert env.ipc_steps == len(gripper_mm)


@pytest.mark.parametrize(
    ("weights", "score"),
    [
        ({"cross": 1.0}, 0.0),
        ({"bar": 1.0}, 2.0),
        ({}, 30 / 36),
        (dict.fromkeys(EndShape, 0.3), 30 / 36),
        ({"cross": 0.0, "bar": 0.0}, 0.5),
        ({"cross": 0.5, "bar": -0.5}, 0.125),
    ],
)
def test_the_brier_score_is_that_of_the_confidences(weights: dict[str, float], score: float) -> None:
    *_, info = played(answer(**weights))
    assert info["confidences"].sum() == pytest.approx(1.0)
    assert info["brier_score"] == pytest.approx(score)
    assert BRIER.read_end(info) == pytest.approx(score)


@pytest.mark.parametrize(
    ("last", "ends"),
    [
        ({"cross": 0.0, "bar": -0.1}, "success"),
        ({"cross": 0.0, "bar": 0.0}, "steps"),
        ({"frame": 1.0}, "steps"),
        ({}, "steps"),
    ],
)
def test_the_answer_of_the_sixth_env_step_decides(last: dict[str, float], ends: str) -> None:
    *_, before = played(*[answer(cross=1.0)] * 5)
    assert before["end_reason"] is None
    _, _, _, terminated, truncated, info = played(*[answer(cross=1.0)] * 5, answer(**last))
    assert info["end_reason"] == ends
    assert (terminated, truncated) == (ends == "success", ends != "success")


def test_a_gripper_that_leaves_its_range_has_failed() -> None:
    *_, info = played(*[answer(1.0, cross=1.0)] * 3)
    assert info["end_reason"] == "error"


def test_the_truth_is_in_no_observation_and_the_expert_touches_around_the_middle() -> None:
    env = ExploreEnv()
    observation, info = env.reset(options=START)
    assert set(observation) == {"marker_flow", "relative_motion"}
    places = []
    while info["end_reason"] is None:
        observation, *_, info = env.step(touch_around(observation, info))
        places.append(tuple(observation["relative_motion"].round(5)))
    assert info["is_success"]
    assert tuple(places[: len(AROUND_MM)]) == AROUND_MM


def test_what_the_options_leave_open_follows_from_the_seed() -> None:
    env: Any = ExploreEnv()
    drawn = []
    for number in range(60):
        env.reset(options={"rng_seed": (0, number)})
        drawn.append((env.task_scene.shape, *env.task_scene.end_pose_mm_deg()))
    assert {shape for shape, *_ in drawn} == set(EndShape)
    largest = np.abs([place for _, *place in drawn]).max(axis=0)
    assert (largest <= [3.0, 3.0, 20.0]).all()
    assert (largest > [2.5, 2.5, 17.0]).all()
    env.reset(options={"rng_seed": (0, 59), "shape": "bar"})
    assert tuple(env.task_scene.end_pose_mm_deg()) == tuple(drawn[-1][1:])


@pytest.mark.parametrize("option", [{"shape": "ball"}, {"end_pose_mm_deg": (0, 0)}, {"end_pose_mm_deg": (4, 0, 0)}])
def test_a_start_that_is_none_is_refused(option: dict[str, Any]) -> None:
    with pytest.raises(ResetOptionsError, match=f"ViTac/Explore-v1: option '{next(iter(option))}'"):
        ExploreEnv().reset(options=option)


def test_boards_order_equal_rates_by_the_brier_score() -> None:
    ranking = load_track("explore").find_ranking("explore")
    assert [key.title for key in ranking.keys] == ["Success rate", "Brier score", "Submitted"]
    rates = {"success_rate": 0.7, "submitted_at": 0.0}
    better, worse = (ranking.sort_key(rates | {"brier_score": score}) for score in (0.3, 0.5))
    assert better < worse
