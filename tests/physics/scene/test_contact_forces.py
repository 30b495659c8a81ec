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
