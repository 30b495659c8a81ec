"""The assembled Newton matrix is the derivative of the assembled forces, whatever the contacts do."""

import numpy as np
import pytest
from engine_probe import Probe
from numpy.typing import NDArray
from small_scenes import Grip
from vitac.envs.fem.linear.elimination import factorise, has_negative_determinant, substitute
from vitac.envs.fem.scene.report import StepStatus

FloatArray = NDArray[np.float64]
STEP_M = 1e-10


@pytest.fixture(scope="module")
def probe() -> Probe:
    """A gripped box that has just been pushed sideways; displacements of the step are large against d_hat."""
    grip = Grip()
    grip.squeeze(0.2e-3)
    assert grip.squeeze(0.1e-3).status is StepStatus.CONVERGED
    start = grip.scene._x.copy()
    assert grip.move(np.array([2e-4, 1e-4, 0.0]), np.array([-1e-4, 1e-4, 0.0])).status is StepStatus.CONVERGED
    random = np.random.default_rng(1)
    return Probe(grip.scene, start_m=start + 1e-5 * random.normal(size=start.shape))


def moved(probe: Probe, nodes: NDArray[np.int64], random: np.random.Generator) -> FloatArray:
    direction = np.zeros_like(probe.x_m)
    direction[nodes] = random.normal(size=(len(nodes), 3))
    return direction


def slope(probe: Probe, direction: FloatArray, step: float = STEP_M) -> FloatArray:
    ahead, behind = probe.at(probe.x_m + step * direction), probe.at(probe.x_m - step * direction)
    return np.asarray((ahead.forces_n - behind.forces_n) / (2 * step))


@pytest.mark.parametrize("seed", range(6))
def test_matrix_times_any_motion_is_the_change_of_forces(probe: Probe, seed: int) -> None:
    here = probe.at(probe.x_m)
    assert here.active_contacts > 50
    direction = moved(probe, probe.unknown_nodes, np.random.default_rng(seed))
    exact = here.matrix_n_m @ direction[probe.unknown_nodes].ravel()
    np.testing.assert_allclose(slope(probe, direction), exact, atol=2e-5 * np.abs(exact).max())


def test_matrix_columns_of_the_body_are_exact(probe: Probe) -> None:
    """The stiff rows of the body would hide errors of its columns in the gels' rows, so these are compared alone."""
    gels = probe.model.system.block.n
    direction = moved(probe, probe.unknown_nodes[gels // 3 :], np.random.default_rng(3))
    exact = (probe.at(probe.x_m).matrix_n_m @ direction[probe.unknown_nodes].ravel())[:gels]
    np.testing.assert_allclose(slope(probe, direction)[:gels], exact, atol=2e-5 * np.abs(exact).max())


def test_coupling_is_the_matrix_times_the_prescribed_motion(probe: Probe) -> None:
    direction = moved(probe, probe.prescribed_nodes, np.random.default_rng(4))
    exact = probe.at(probe.x_m, prescribed_move_m=direction).coupling_n
    np.testing.assert_allclose(slope(probe, direction), exact, atol=2e-5 * np.abs(exact).max())


def test_matrix_is_unsymmetric_with_friction_and_symmetric_without() -> None:
    for friction, symmetric in ((2.0, False), (0.0, True)):
        grip = Grip(friction=friction)
        grip.squeeze(0.2e-3)
        start = grip.scene._x.copy()
        grip.move(np.array([2e-4, 1e-4, 0.0]), np.array([-1e-4, 1e-4, 0.0]))
        matrix = Probe(grip.scene, start_m=start).at(grip.scene._x).matrix_n_m
        difference = np.abs(matrix - matrix.T).max() / np.abs(matrix).max()
        assert bool(difference < 1e-12) is symmetric


def test_projected_matrix_is_symmetric_positive_definite(probe: Probe) -> None:
    matrix = probe.at(probe.x_m, projected=True).matrix_n_m
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
    scale = 1 / np.sqrt(np.diag(matrix))
    assert np.linalg.eigvalsh(scale[:, None] * matrix * scale).min() > 0


def test_projected_matrix_has_the_same_forces(probe: Probe) -> None:
    exact, projected = probe.at(probe.x_m), probe.at(probe.x_m, projected=True)
    size = np.abs(exact.forces_n).max()
    np.testing.assert_allclose(projected.forces_n, exact.forces_n, atol=1e-12 * size)


def test_projected_matrix_is_positive_definite_far_from_equilibrium(probe: Probe) -> None:
    """Random strains of a tenth of the element size, with contacts as they fall."""
    random = np.random.default_rng(8)
    for _ in range(5):
        x = probe.x_m.copy()
        gel_nodes = probe.unknown_nodes[: probe.model.system.block.nodes]
        x[gel_nodes] += 1.5e-4 * random.uniform(-1, 1, (len(gel_nodes), 3))
        matrix = probe.at(x, projected=True).matrix_n_m
        scale = 1 / np.sqrt(np.diag(matrix))
        assert np.linalg.eigvalsh(scale[:, None] * matrix * scale).min() > 0


def test_newton_direction_solves_the_assembled_system(probe: Probe) -> None:
    here = probe.at(probe.x_m)
    workspace, system = probe._workspace, probe.model.system
    rhs = workspace.system.right_hand_side.copy()
    np.testing.assert_array_equal(rhs, -here.forces_n)
    assert factorise(system, workspace.system.entries, workspace.factor, False)
    assert has_negative_determinant(workspace.factor) is bool(np.linalg.slogdet(here.matrix_n_m)[0] < 0)
    solution = rhs.copy()
    substitute(system, workspace.factor, solution)
    np.testing.assert_allclose(here.matrix_n_m @ solution, rhs, atol=1e-9 * np.abs(rhs).max())
    expected = np.linalg.solve(here.matrix_n_m, rhs)
    np.testing.assert_allclose(solution, expected, atol=1e-9 * np.abs(expected).max())


def test_contact_forces_on_all_bodies_sum_to_zero(probe: Probe) -> None:
    """Elastic, barrier and friction forces are internal; the prescribed nodes included, they cancel."""
    probe_at_rest = probe.at(probe.x_m)
    inertia = np.zeros(3)
    masses = probe.model.unknowns.node_mass_kg[probe.unknown_nodes]
    h2 = probe.model.parameters.time_step_s**2
    inertia += (masses[:, None] * (probe.x_m - probe.x_hat_m)[probe.unknown_nodes]).sum(axis=0) / h2
    for i, first in enumerate(probe.model.affine.first_node):
        offsets = (probe.x_m - probe.x_hat_m)[first : first + 4]
        inertia += (probe.model.affine.mass_kg[i] @ offsets).sum(axis=0) / h2
    total = probe_at_rest.all_forces_n.sum(axis=0)
    np.testing.assert_allclose(total, inertia, atol=1e-9 * np.abs(probe_at_rest.all_forces_n).sum())


def test_pairs_that_are_still_too_far_apart_are_not_missed(probe: Probe) -> None:
    """Forces from an old list, told how far bodies have moved since, are those from a new one."""
    moved_m = probe.x_m + moved(probe, probe.unknown_nodes, np.random.default_rng(5)) * 1e-6
    new, old = probe.at(moved_m), probe.at(moved_m, listed_at_m=probe.x_m)
    np.testing.assert_allclose(old.all_forces_n, new.all_forces_n, atol=1e-12 * np.abs(new.all_forces_n).max())
    assert old.active_contacts == new.active_contacts
