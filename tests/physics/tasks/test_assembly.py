"""A part that is fetched, put in and turned: forces, friction, energy, the lock, and the steps of time and mesh."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.scene.gripper import SENSOR_COUNT
from vitac.envs.tactile.gel import GelCells, structured_gel
from vitac.envs.tasks.assembly.env import AssemblyEnv, assembly_physics, fetch_insert_and_turn

FloatArray = NDArray[np.float64]
START = {"shape": "narrow", "offset_mm_deg": (0.0, -0.5, 0.0), "rng_seed": (0, 1)}
GEL_FRICTION, PART_FRICTION, WEIGHT_N = 1.0, 0.3, 0.08 * 9.81
HELD, FIXED = SENSOR_COUNT, SENSOR_COUNT + 1


def play_until(stage: int, **settings: Any) -> Any:
    """The environment after the expert has reached a stage."""
    env = AssemblyEnv(**settings)
    observation, info = env.reset(options=START)
    while info["stage"] < stage and info["end_reason"] is None:
        observation, *_, info = env.step(fetch_insert_and_turn(observation, info))
    assert info["stage"] == stage
    return env


def play(env: Any, *actions: tuple[float, ...]) -> Any:
    """The info after env steps with these actions [mm, mm, mm, deg, mm]."""
    for action in actions:
        *_, info = env.step((np.array(action) / np.array(env.task.action_scale)).astype(np.float32))
    assert env.scene.solved
    return info


def forces_on_part(env: Any, other: int) -> tuple[FloatArray, FloatArray]:
    """Places [m] and forces [N] of the contacts of another body on the part."""
    pairs = env.scene.pair_forces()
    acts = (pairs.bodies == (HELD, other)).all(axis=1)
    reacts = (pairs.bodies == (other, HELD)).all(axis=1)
    points = np.concatenate([pairs.points_m[acts], pairs.points_m[reacts]])
    return points, np.concatenate([pairs.forces_n[acts], -pairs.forces_n[reacts]])


@pytest.fixture(scope="module")
def locked() -> tuple[Any, Any]:
    """The locked part, and its state."""
    env = play_until(4)
    return env, env.snapshot()


@pytest.fixture
def lock(locked: tuple[Any, Any]) -> Any:
    env, state = locked
    env.restore(state)
    return env


def test_socket_gels_and_weight_hold_the_part_in_balance_while_it_is_pressed_against_its_stops(lock: Any) -> None:
    play(lock, (0, 0, 0, 2.0, 0), (0, 0, 0, 0, 0))
    contacts = [forces_on_part(lock, other) for other in (0, 1, FIXED)]
    forces_n = np.concatenate([forces for _, forces in contacts])
    moments = np.concatenate([np.cross(points, forces) for points, forces in contacts])
    points, stops_n = contacts[2]
    stops_n_m = np.cross(points - [0.026, 0.0, 0.0], stops_n)[:, 2].sum()
    assert stops_n_m < -0.02, "the stops hold against the turn"
    assert forces_n.sum(axis=0) == pytest.approx([0.0, 0.0, WEIGHT_N], abs=0.01)
    middle_m = 1e-3 * np.array([26.0, 0.0, -7.8])
    weight = np.cross(middle_m, [0.0, 0.0, -WEIGHT_N])
    # Friction acts across gaps of up to 0.1 mm.
    assert moments.sum(axis=0) + weight == pytest.approx(np.zeros(3), abs=0.02 * abs(stops_n_m))


def test_friction_stays_in_its_cone(lock: Any) -> None:
    play(lock, (0, 0, 1.5, 1.0, 0))
    turn_rad = np.radians(lock.task_scene.offset_mm_deg()[3])
    normal = np.array([-np.sin(turn_rad), np.cos(turn_rad), 0.0])
    for gel in (0, 1):
        forces_n = forces_on_part(lock, gel)[1]
        along = forces_n @ normal
        across = np.linalg.norm(forces_n - along[:, None] * normal, axis=1)
        assert np.abs(along).sum() > 5.0
        assert (across < 1.01 * GEL_FRICTION * np.abs(along) + 0.01).all()
    lip_n = forces_on_part(lock, FIXED)[1].sum(axis=0)
    assert lip_n[2] < -3.0


def test_locked_part_cannot_be_pulled_out_and_an_inserted_one_can(lock: Any) -> None:
    info = play(lock, *[(0, 0, 2.0, 0, 0)] * 3)
    assert info["offset_mm_deg"][2] < -6.9
    assert lock.scene.contact_forces_n()[0, 2] < -5.0
    inserted = play_until(3)
    info = play(inserted, *[(0, 0, 2.0, 0, 0)] * 3)
    assert info["offset_mm_deg"][2] == pytest.approx(-1.8, abs=0.1)
    assert inserted.scene.contact_forces_n()[0, 2] == pytest.approx(-WEIGHT_N, abs=0.02), "it hangs by its weight"


def test_locked_part_stays_where_it_is_let_go(lock: Any) -> None:
    info = play(lock, *[(0, 0, 0, 0, 2.0)] * 2, *[(0, 0, 3.0, 0, 0)] * 3)
    assert info["grip_force_n"] == pytest.approx(0.0, abs=1e-3)
    assert info["offset_mm_deg"][2] == pytest.approx(-8.5 + 0.09, abs=0.03), "on the floor"
    assert info["offset_mm_deg"][3] > 57.0


@pytest.mark.parametrize(("pull_mm", "slides"), [(0.9, False), (3.0, True)])
def test_pulling_at_the_lock_and_letting_up_costs_energy_and_yields_none(
    lock: Any, pull_mm: float, *, slides: bool
) -> None:
    scene, work_j, largest_j = lock.scene, 0.0, 0.0
    last = [scene.pose.z_m, -scene.contact_forces_n()[0, 2] - WEIGHT_N]

    def add_work() -> None:
        nonlocal work_j, largest_j
        force_n = -scene.contact_forces_n()[0, 2] - WEIGHT_N  # of the gripper on the part, beside the weight
        work_j += 0.5 * (force_n + last[1]) * (scene.pose.z_m - last[0])
        largest_j = max(largest_j, work_j)
        last[:] = scene.pose.z_m, force_n

    scene.after_ipc_step = add_work
    parts = 5
    play(lock, *[(0, 0, pull_mm / parts, 0, 0)] * parts, *[(0, 0, -pull_mm / parts, 0, 0)] * parts)
    assert largest_j > 2e-4
    assert work_j > -0.01 * largest_j
    assert (work_j > 0.3 * largest_j) == slides


@pytest.mark.slow
def test_half_the_time_step_gives_the_same_assembly() -> None:
    found = []
    for ipc_steps in (1, 2):
        env = play_until(4, physics=replace(assembly_physics(), time_step_s=0.2 / ipc_steps), ipc_steps=ipc_steps)
        info = play(env, (0, 0, 1.2, 0, 0), (0, 0, 0, 0, 0))
        found.append([info["steps"], info["grip_force_n"], env.scene.contact_forces_n()[0, 2]])
    assert found[0] == pytest.approx(found[1], rel=0.01)


@pytest.mark.slow
def test_half_the_cells_of_the_gels_pull_at_the_lock_nearly_as_hard() -> None:
    cells = [GelCells(x=count, y=count, layers=2, is_hexahedral=True) for count in (6, 12)]
    forces_n = []
    for each in cells:
        env = play_until(4, gel=structured_gel(name="gel", cells=each))
        play(env, (0, 0, 1.2, 0, 0))
        forces_n.append(env.scene.contact_forces_n()[0, 2] / env.scene.grip_force_n())
    assert forces_n[0] == pytest.approx(forces_n[1], rel=0.04)


def test_expert_with_the_truth_locks_the_part_and_the_same_actions_give_the_same_states() -> None:
    env: Any = AssemblyEnv()
    observation, info = env.reset(options=START)
    actions, hashes = [], []
    while info["end_reason"] is None:
        actions.append(fetch_insert_and_turn(observation, info))
        observation, *_, info = env.step(actions[-1])
        hashes.append(env.state_hash())
    assert info["end_reason"] == "success"
    assert max(info["surface_diff_m"]) < 5e-4
    again: Any = AssemblyEnv()
    again.reset(options=START)
    for action, state_hash in zip(actions, hashes, strict=True):
        again.step(action)
        assert again.state_hash() == state_hash
