"""An elastic plug that two gels press on a plate and into a hole: balance, friction, and what the step of time does."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from intersection_check import GraspedSceneCheck
from vitac.envs.fem.scene.scene import StepStatus
from vitac.envs.scene.gripper import SENSOR_COUNT
from vitac.envs.tasks.settings import arena_physics
from vitac.envs.tasks.soft_plug.env import SoftPlugEnv, move_over_then_push
from vitac.envs.tasks.soft_plug.scene import CELLS

HELD, FIXED = SENSOR_COUNT, SENSOR_COUNT + 1
GEL_FRICTION, PART_FRICTION = 1.0, 0.3
BESIDE = {"shape": "stopper", "offset_mm": (2.0, 0.5), "rng_seed": (0, 1)}
DOWN = [0.0, 0.0, -0.5]


def pressed(*actions: list[float], start: dict[str, Any] = BESIDE, **settings: Any) -> Any:
    env = SoftPlugEnv(**settings)
    env.reset(options=start)
    for action in actions:
        env.step(np.array(action, dtype=np.float32))
    assert env.scene.solved
    return env


@pytest.fixture(scope="module")
def beside_the_hole() -> Any:
    """The plug stands on the edge of the hole."""
    return pressed(*[DOWN] * 5)


def test_plate_and_gels_hold_the_plug_in_balance(beside_the_hole: Any) -> None:
    scene = beside_the_hole.scene
    from_plate_n = scene.force_on_held_n(FIXED)
    total_n = sum(scene.force_on_held_n(other) for other in (0, 1, FIXED))
    assert from_plate_n[2] > 3.0
    assert np.abs(total_n).max() < 0.01
    assert scene.contact_forces_n()[0] == pytest.approx(from_plate_n, abs=0.01)
    assert scene.gripper_width_m < 9.5e-3


def test_every_contact_of_the_plug_stays_in_its_friction_cone(beside_the_hole: Any) -> None:
    pairs = beside_the_hole.scene.pair_forces()
    for other, friction in ((0, GEL_FRICTION), (1, GEL_FRICTION), (FIXED, PART_FRICTION)):
        of_both = (np.sort(pairs.bodies, axis=1) == (min(HELD, other), max(HELD, other))).all(axis=1)
        normal_n = (pairs.forces_n[of_both] * pairs.normals[of_both]).sum(axis=1)
        tangential = pairs.forces_n[of_both] - normal_n[:, None] * pairs.normals[of_both]
        assert of_both.sum() > 2
        assert (np.linalg.norm(tangential, axis=1) <= 1.001 * friction * np.abs(normal_n) + 1e-6).all()


def test_supported_side_is_lifted_and_the_plate_pushes_towards_the_hole(beside_the_hole: Any) -> None:
    scene, heights_mm = beside_the_hole.scene, beside_the_hole.task_scene.heights_mm()
    x_mm = 1e3 * scene.held_vertices_m(beside_the_hole.task_scene.measured_vertices)[:, 0]
    assert heights_mm[x_mm > 2.0].min() > heights_mm[x_mm < 2.0].max() + 0.5
    assert scene.force_on_held_n(FIXED)[0] < -0.3


@pytest.mark.parametrize("shape", ["stopper", "slim"])
def test_with_the_truth_the_plug_goes_in_unbent_and_nothing_penetrates(shape: str) -> None:
    env = SoftPlugEnv(force_limit_n=8.0)
    observation, info = env.reset(options=BESIDE | {"shape": shape})
    check = GraspedSceneCheck(env.scene)
    while info["end_reason"] is None:
        observation, *_, info = env.step(move_over_then_push(observation, info))
        assert not check.intersects(env.scene)
        assert all(report.status is not StepStatus.NOT_CONVERGED for report in info["step_reports"])
    assert info["end_reason"] == "success"
    assert info["largest_bend_mm"] < 0.2
    assert env.scene.force_on_held_n(FIXED)[2] > 0.5, "the hole is tight"


def test_pushed_straight_down_beside_the_hole_it_is_crushed_or_snaps_in_bent() -> None:
    env = SoftPlugEnv(force_limit_n=8.0)
    _, info = env.reset(options=BESIDE)
    while info["end_reason"] is None:
        *_, info = env.step(np.array(DOWN, dtype=np.float32))
    assert info["end_reason"] in {"force", "error"}


@pytest.mark.slow
def test_half_the_step_of_time_gives_the_same(beside_the_hole: Any) -> None:
    finer = pressed(*[DOWN] * 5, ipc_steps=8, physics=replace(arena_physics(), time_step_s=0.05))
    force_n = beside_the_hole.scene.force_on_held_n(FIXED)
    assert finer.scene.force_on_held_n(FIXED) == pytest.approx(force_n, rel=0.02, abs=0.02)
    assert finer.task_scene.heights_mm() == pytest.approx(beside_the_hole.task_scene.heights_mm(), abs=0.02)


@pytest.mark.slow
def test_finer_cells_of_the_plug_change_little(beside_the_hole: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vitac.envs.tasks.soft_plug.scene.CELLS", replace(CELLS, layers=14))
    finer = pressed(*[DOWN] * 5)
    force_n = beside_the_hole.scene.force_on_held_n(FIXED)
    assert finer.scene.force_on_held_n(FIXED)[2] == pytest.approx(force_n[2], rel=0.05)
