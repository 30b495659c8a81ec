"""Contact forces that an IPC step reports."""

import numpy as np
import pytest
from engine_probe import Probe
from small_scenes import Grip, arena_contact
from vitac.envs.fem.model.settings import ArenaContactSettings


@pytest.mark.parametrize("contact", [None, arena_contact(0.5)])
def test_reported_forces_are_those_of_the_contacts_on_each_gel(contact: ArenaContactSettings | None) -> None:
    grip = Grip(contact=contact)
    for _ in range(3):
        report = grip.squeeze(1e-4)
    report = grip.move(np.array([2e-4, 0.0, 0.0]), np.array([2e-4, 0.0, 1e-4]))
    forces, start = Probe(grip.scene).at(grip.scene._x).all_forces_n, 0
    for gel, reported in zip(grip.gels, report.gel_forces_n, strict=True):
        # At rest the back holds what the contacts push with.
        back = forces[start + gel.mesh.driven_nodes].sum(axis=0)
        np.testing.assert_allclose(reported, -back, atol=1e-9)
        start += len(gel.mesh.rest_position_m)
    assert report.gel_forces_n[0][2] < -0.5 < 0.5 < report.gel_forces_n[1][2]


def test_force_on_the_part_is_what_the_gels_do_not_cancel() -> None:
    grip = Grip()
    for _ in range(3):
        report = grip.squeeze(1e-4)
    assert report.part_force_n == pytest.approx(np.linalg.norm(np.sum(report.gel_forces_n, axis=0)))
    assert report.part_force_n < 0.01 * abs(report.gel_forces_n[0][2])


@pytest.mark.parametrize("contact", [None, arena_contact(0.5)])
def test_forces_of_pairs_add_up_to_those_of_the_bodies(contact: ArenaContactSettings | None) -> None:
    grip = Grip(contact=contact)
    assert len(grip.scene.contact_forces().forces_n) == 0
    for _ in range(3):
        grip.squeeze(1e-4)
    report = grip.move(np.array([2e-4, 0.0, 0.0]), np.array([2e-4, 0.0, 1e-4]))
    found = grip.scene.contact_forces()
    assert len(found.bodies) == report.active_contacts
    first, second = found.bodies.T
    for gel, reported in enumerate(report.gel_forces_n):
        total = found.forces_n[first == gel].sum(axis=0) - found.forces_n[second == gel].sum(axis=0)
        np.testing.assert_allclose(total, reported, atol=2e-3)
    assert np.abs(found.points_m[:, 2]) == pytest.approx(0.005, abs=2e-4)


@pytest.mark.parametrize("contact", [None, arena_contact(0.5)])
def test_forces_on_the_nodes_of_a_gel_are_those_that_its_back_holds(contact: ArenaContactSettings | None) -> None:
    """Force and moment, so that they act on the right nodes; on both sides of a pair they cancel."""
    grip = Grip(contact=contact)
    assert not any(on_nodes_n.any() for on_nodes_n in grip.scene.gel_contact_forces_n())
    for _ in range(3):
        grip.squeeze(1e-4)
    grip.move(np.array([2e-4, 0.0, 0.0]), np.array([2e-4, 0.0, 1e-4]))
    forces, start = Probe(grip.scene).at(grip.scene._x).all_forces_n, 0
    for index, (gel, on_nodes_n) in enumerate(zip(grip.gels, grip.scene.gel_contact_forces_n(), strict=True)):
        nodes_m, driven = grip.scene.gel_positions_m(index), gel.mesh.driven_nodes
        back_n = -forces[start + driven]
        np.testing.assert_allclose(on_nodes_n.sum(axis=0), back_n.sum(axis=0), atol=2e-3)
        held_n_m = np.cross(nodes_m[driven], back_n).sum(axis=0)
        np.testing.assert_allclose(np.cross(nodes_m, on_nodes_n).sum(axis=0), held_n_m, atol=2e-5)
        assert np.abs(held_n_m).max() > 1e-3
        inside = np.setdiff1d(np.arange(len(nodes_m)), gel.mesh.surface_nodes)
        assert not on_nodes_n[inside].any()
        start += len(nodes_m)
