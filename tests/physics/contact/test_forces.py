"""Friction that remembers where it sticks (`arena-2`), on small scenes and against formulas."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from engine_probe import Probe
from falling_bodies import GRAVITY_M_S2, on_incline, turned_about_y
from numpy.typing import NDArray
from small_scenes import Grip, arena_contact
from vitac.envs.fem.contact.forces import ContactMemory, sorted_memory
from vitac.envs.fem.model.settings import ArenaContactSettings, PairFriction, UnknownMaterials
from vitac.envs.fem.scene.report import StepStatus

FloatArray = NDArray[np.float64]
SLOPE_RAD = float(np.arctan(0.5))
STIFFNESS_N_M = ArenaContactSettings().tangential_stiffness_n_m


def held_load_n(grip: Grip, shear_m: float, ipc_steps: int) -> tuple[FloatArray, FloatArray]:
    """Force on the lower gel's back and place of the box, so many IPC steps without motion after a shear."""
    for _ in range(3):
        grip.squeeze(1e-4)
    grip.move(np.array([shear_m, 0.0, 0.0]), np.array([-shear_m, 0.0, 0.0]))
    for _ in range(ipc_steps):
        assert grip.move(np.zeros(3), np.zeros(3)).status is StepStatus.CONVERGED
    return back_force_n(grip), grip.scene.body_vertices_m(0).mean(axis=0)


def back_force_n(grip: Grip) -> FloatArray:
    """Force that holds the back face of the lower gel: elasticity alone acts there."""
    driven = grip.gels[0].mesh.driven_nodes
    return np.asarray(Probe(grip.scene).at(grip.scene._x).all_forces_n[driven].sum(axis=0))


def test_sheared_grip_holds_its_force() -> None:
    force, place = held_load_n(Grip(contact=arena_contact(5.0)), 5e-4, 2)
    force_later, place_later = held_load_n(Grip(contact=arena_contact(5.0)), 5e-4, 20)
    assert abs(force[0]) > 0.5
    np.testing.assert_allclose(force_later, force, atol=1e-5)
    np.testing.assert_allclose(place_later, place, atol=1e-8)


def test_the_challenge_model_lets_the_same_grip_relax() -> None:
    force, _ = held_load_n(Grip(friction=5.0), 5e-4, 0)
    force_later, _ = held_load_n(Grip(friction=5.0), 5e-4, 20)
    assert abs(force_later[0]) < 0.5 * abs(force[0])


def test_force_after_a_shear_does_not_depend_on_the_time_step() -> None:
    forces = [held_load_n(Grip(contact=arena_contact(5.0), time_step_s=h), 5e-4, 1)[0][0] for h in (0.2, 0.1, 0.01)]
    np.testing.assert_allclose(forces, forces[0], rtol=5e-3)


@pytest.mark.parametrize("time_step_s", [0.1, 0.01])
def test_block_stays_on_an_incline_at_nine_tenths_of_the_friction_limit(time_step_s: float) -> None:
    fall = on_incline(SLOPE_RAD, 1.0, contact=arena_contact(0.5 / 0.9), time_step_s=time_step_s)
    down = turned_about_y(SLOPE_RAD) @ [1.0, 0.0, 0.0]
    for _ in range(10):
        fall.step()
    settled = fall.scene.body_vertices_m(1).mean(axis=0)
    for _ in range(100):
        assert fall.step().status is not StepStatus.NOT_CONVERGED
    assert abs((fall.scene.body_vertices_m(1).mean(axis=0) - settled) @ down) < 1e-7


def test_block_accelerates_above_the_friction_angle() -> None:
    friction = 0.3
    fall = on_incline(SLOPE_RAD, 1.0, contact=arena_contact(friction))
    down = turned_about_y(SLOPE_RAD) @ [1.0, 0.0, 0.0]
    speeds = []
    for _ in range(14):
        assert fall.step().status is not StepStatus.NOT_CONVERGED
        speeds.append(float(fall.velocity_m_s(1) @ down))
    expected = GRAVITY_M_S2 * (np.sin(SLOPE_RAD) - friction * np.cos(SLOPE_RAD))
    np.testing.assert_allclose(np.diff(speeds[6:]) / 0.01, expected, rtol=1e-2)


def sheared() -> tuple[Grip, FloatArray, ContactMemory]:
    """A grip whose contacts stick and slide, the start of its last IPC step, and what contacts remembered there."""
    grip = Grip(contact=arena_contact(0.5))
    for _ in range(3):
        grip.squeeze(1e-4)
    for _ in range(2):
        start, memory = grip.scene._x.copy(), grip.scene._memory
        assert grip.move(np.array([2e-4, 1e-4, 0.0]), np.array([-1e-4, 1e-4, 0.0])).status is StepStatus.CONVERGED
    return grip, start, memory


def test_what_contacts_remember_is_the_spring_that_holds_their_friction() -> None:
    grip, _, _ = sheared()
    held_n = STIFFNESS_N_M * np.sqrt((grip.scene._memory.slip_m**2).sum(axis=1))
    contacts = grip.scene.contact_forces()
    normal_n = (contacts.forces_n * contacts.normals).sum(axis=1)
    rubbing_n = contacts.forces_n - normal_n[:, None] * contacts.normals
    tangential_n = np.sqrt((rubbing_n**2).sum(axis=1))
    np.testing.assert_allclose(np.sort(held_n), np.sort(tangential_n), rtol=3e-3)
    part = tangential_n / (0.5 * normal_n)
    assert part.max() <= 1 + 1e-9, "friction is never more than Coulomb's"
    assert (part > 0.99).any()
    assert (part < 0.9).any()


def test_matrix_is_the_change_of_forces_where_contacts_remember() -> None:
    """All but the turning of the frame, by its edge of millimetres to a slip of micrometres."""
    grip, start, memory = sheared()
    probe = Probe(grip.scene, start_m=start)
    probe.memory = memory
    direction = np.zeros_like(probe.x_m)
    direction[probe.unknown_nodes] = np.random.default_rng(2).normal(size=(len(probe.unknown_nodes), 3))
    exact = probe.at(probe.x_m).matrix_n_m @ direction[probe.unknown_nodes].ravel()
    step = 1e-10
    ahead, behind = probe.at(probe.x_m + step * direction), probe.at(probe.x_m - step * direction)
    slope = (ahead.forces_n - behind.forces_n) / (2 * step)
    np.testing.assert_allclose(slope, exact, atol=1e-3 * np.abs(exact).max())


def test_state_covers_what_contacts_remember() -> None:
    grip, _, _ = sheared()
    state, before = grip.scene.state(), grip.scene.state_bytes()
    forgotten = state._replace(memory=state.memory._replace(slip_m=np.zeros_like(state.memory.slip_m)))
    nothing, held = np.zeros(3), []
    for start in (state, state, forgotten):
        grip.scene.restore(start)
        grip.move(nothing, nothing)
        held.append(grip.scene.state_bytes())
    assert held[0] == held[1] != held[2]
    grip.scene.restore(forgotten)
    assert grip.scene.state_bytes() != before


def test_pickled_state_continues_to_the_same_bits_in_another_scene() -> None:
    grip, _, _ = sheared()
    other, ends = Grip(contact=arena_contact(0.5)), []
    other.scene.restore(pickle.loads(pickle.dumps(grip.scene.state())))  # noqa: S301 - our own bytes
    other.targets_m = grip.targets_m
    assert other.scene.state_bytes() == grip.scene.state_bytes()
    for continued in (grip, other):
        continued.move(np.array([5e-5, 0.0, 0.0]), np.zeros(3))
        ends.append(continued.scene.state_bytes())
    assert ends[0] == ends[1]


def test_the_challenge_model_remembers_nothing() -> None:
    grip = Grip()
    for _ in range(3):
        grip.squeeze(1e-4)
    assert len(grip.scene._memory.pairs) == 0
    assert len(grip.scene.state_bytes()) == 2 * grip.scene._x.size * 8


def test_sorted_memory_is_in_ascending_order_of_the_pairs() -> None:
    pairs = np.random.default_rng(0).integers(0, 3, (50, 6))
    ordered = sorted_memory(ContactMemory(pairs, pairs[:, :3].astype(float), pairs[:, :3].astype(float))).pairs
    names = [tuple(row[:5]) for row in ordered.tolist()]
    assert names == sorted(names)


def test_friction_of_unknown_materials_is_refused() -> None:
    pairs = (PairFriction(first="gel", second="steel", coefficient=0.4),)
    with pytest.raises(UnknownMaterials, match="no friction coefficient of gel against gel"):
        Grip(contact=replace(ArenaContactSettings(), pair_frictions=pairs))
