"""A rod that an edge turns between two gels: forces, friction, energy, and what the steps of time and mesh do."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.scene.gripper import SENSOR_COUNT
from vitac.envs.tactile.gel import GelCells, structured_gel
from vitac.envs.tasks.in_hand_turn.env import InHandTurnEnv, press_until_it_stays, turn_physics

FloatArray = NDArray[np.float64]
START = {"shape": "narrow", "start_mm_deg": (3.0, -2.0, 20.0), "rng_seed": (0, 1)}
GEL_FRICTION, PART_FRICTION = 0.3, 0.3
HELD, FIXED = SENSOR_COUNT, SENSOR_COUNT + 1


def pressed(*ways: float, **settings: Any) -> Any:
    """The environment after env steps with these actions along x."""
    env = InHandTurnEnv(**settings)
    env.reset(options=START)
    for way in ways:
        env.step(np.array([way, 0.0], dtype=np.float32))
    assert env.scene.solved
    return env


def forces_on_rod(env: Any, other: int) -> tuple[FloatArray, FloatArray]:
    """Places [m] and forces [N] of the contacts of another body on the rod."""
    pairs = env.scene.pair_forces()
    acts = (pairs.bodies == (HELD, other)).all(axis=1)
    reacts = (pairs.bodies == (other, HELD)).all(axis=1)
    points = np.concatenate([pairs.points_m[acts], pairs.points_m[reacts]])
    return points, np.concatenate([pairs.forces_n[acts], -pairs.forces_n[reacts]])


@pytest.fixture(scope="module")
def sliding() -> Any:
    """The rod slides between the gels and along the edge."""
    return pressed(1.0, 1.0, 1.0)


def test_edge_and_gels_hold_the_rod_in_balance(sliding: Any) -> None:
    contacts = [forces_on_rod(sliding, other) for other in (0, 1, FIXED)]
    forces_n = np.concatenate([forces for _, forces in contacts])
    moments = np.concatenate([np.cross(points, forces) for points, forces in contacts])
    assert np.linalg.norm(contacts[2][1].sum(axis=0)) > 3.0
    assert np.abs(forces_n.sum(axis=0)).max() < 0.01
    assert np.abs(moments.sum(axis=0)).max() < 0.01 * 0.02


def test_friction_stays_in_its_cone_and_is_fully_developed_where_the_rod_slides(sliding: Any) -> None:
    for gel in (0, 1):
        _, forces_n = forces_on_rod(sliding, gel)
        tangential, normal = np.hypot(forces_n[:, 0], forces_n[:, 2]), np.abs(forces_n[:, 1])
        assert (tangential < 1.005 * GEL_FRICTION * normal + 1e-3).all()
        # The rod turns about a place between the gels, near which little slides.
        assert tangential.sum() > 0.95 * GEL_FRICTION * normal.sum()
    angle_rad = np.radians(sliding.task_scene.angle_deg())
    along, away = np.array([[np.sin(angle_rad), 0.0, np.cos(angle_rad)], [-np.cos(angle_rad), 0.0, np.sin(angle_rad)]])
    force_n = forces_on_rod(sliding, FIXED)[1].sum(axis=0)
    assert force_n @ away > 3.0
    assert abs(force_n @ along) == pytest.approx(PART_FRICTION * (force_n @ away), rel=0.02)


def test_rod_turns_back_by_what_it_had_twisted_the_gels() -> None:
    env = pressed(1.0, 1.0)
    before_deg, twist_deg = env.task_scene.angle_deg(), env.task_scene.twist_deg()
    env.step(np.array([-1.0, 0.0], dtype=np.float32))
    assert np.abs(env.scene.contact_forces_n()[0]).max() < 1e-3, "the rod is free"
    assert twist_deg > 3.0
    assert before_deg - env.task_scene.angle_deg() == pytest.approx(0.92 * twist_deg, rel=0.05)
    still_deg = env.task_scene.angle_deg()
    env.step(np.array([-1.0, 0.0], dtype=np.float32))
    assert env.task_scene.angle_deg() == pytest.approx(still_deg, abs=1e-3), "and keeps its angle"


@pytest.mark.parametrize(("ways", "slides"), [((0.66, -0.66), False), ((1.0, 1.0, -1.0, -1.0), True)])
def test_pressing_and_freeing_costs_energy_and_yields_none(ways: tuple[float, ...], slides: bool) -> None:
    env = pressed()
    scene, work_j, largest_j = env.scene, 0.0, 0.0
    last = [scene.pose.x_m, 0.0]

    def add_work() -> None:
        nonlocal work_j, largest_j
        force_n = -scene.contact_forces_n()[0, 0]  # of the gripper on what it holds
        work_j += 0.5 * (force_n + last[1]) * (scene.pose.x_m - last[0])
        largest_j = max(largest_j, work_j)
        last[:] = scene.pose.x_m, force_n

    scene.after_ipc_step = add_work
    for way in ways:
        env.step(np.array([way, 0.0], dtype=np.float32))
    assert largest_j > 1e-4
    assert work_j > -0.01 * largest_j
    assert (work_j > 0.5 * largest_j) == slides


def test_half_the_time_step_gives_the_same_turn() -> None:
    whole, half = (
        pressed(1.0, 1.0, -1.0, physics=replace(turn_physics(), time_step_s=step_s)) for step_s in (0.1, 0.05)
    )
    assert whole.task_scene.angle_deg() == pytest.approx(half.task_scene.angle_deg(), abs=0.02)


def test_half_the_cells_of_the_gels_turn_the_rod_nearly_as_far() -> None:
    cells = [GelCells(x=count, y=count, layers=2, is_hexahedral=True) for count in (6, 12)]
    coarse, fine = (pressed(1.0, 1.0, gel=structured_gel(name="gel", cells=each)) for each in cells)
    forces_n = [np.linalg.norm(env.scene.contact_forces_n()[0]) for env in (coarse, fine)]
    assert forces_n[0] == pytest.approx(forces_n[1], rel=0.05)
    for env in (coarse, fine):
        env.step(np.array([-1.0, 0.0], dtype=np.float32))
    assert coarse.task_scene.angle_deg() == pytest.approx(fine.task_scene.angle_deg(), abs=0.4)


def test_expert_with_the_truth_meets_the_goal_and_the_same_actions_the_same_states() -> None:
    env: Any = InHandTurnEnv()
    observation, info = env.reset(options=START)
    actions, hashes = [], []
    while info["end_reason"] is None:
        actions.append(press_until_it_stays(observation, info))
        observation, *_, info = env.step(actions[-1])
        hashes.append(env.state_hash())
    assert info["end_reason"] == "success"
    assert info["angle_error_deg"] < 0.5
    again: Any = InHandTurnEnv()
    again.reset(options=START)
    for action, state_hash in zip(actions, hashes, strict=True):
        again.step(action)
        assert again.state_hash() == state_hash
