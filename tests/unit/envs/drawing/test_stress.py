import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.drawing.stress import (
    cauchy_stress_pa,
    contact_pressure_pa,
    deformation_gradients,
    displacement_m,
    nodal_means,
    von_mises_pa,
)
from vitac.envs.tactile.gel import gelsight_mini_mesh

FloatArray = NDArray[np.float64]

E_PA, NU = 3e5, 0.3
MU_PA = E_PA / (2 * (1 + NU))
LAMBDA_PA = E_PA * NU / ((1 + NU) * (1 - 2 * NU))


def rotation_about(axis: tuple[float, float, float], angle_rad: float) -> FloatArray:
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle_rad) * K + (1 - np.cos(angle_rad)) * K @ K)


def stress_pa(F: FloatArray) -> FloatArray:
    return np.asarray(cauchy_stress_pa(F[None], youngs_modulus_pa=E_PA, poisson_ratio=NU)[0])


def energy_density(F: FloatArray) -> float:
    log_j = np.log(np.linalg.det(F))
    return float(0.5 * MU_PA * (np.trace(F.T @ F) - 3) - MU_PA * log_j + 0.5 * LAMBDA_PA * log_j**2)


def test_deformation_gradient_of_an_affine_motion_is_its_matrix() -> None:
    gel = gelsight_mini_mesh()
    F = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.05], [0.0, 0.1, 1.2]])
    moved = gel.rest_position_m @ F.T + np.array([0.3, -0.1, 0.2])
    assert deformation_gradients(gel.rest_position_m, moved, gel.tetrahedra) == pytest.approx(
        np.broadcast_to(F, (320, 3, 3)), abs=1e-12
    )


@pytest.mark.parametrize("stretch", [0.7, 0.95, 1.0, 1.3])
def test_uniaxial_stretch_without_lateral_strain_has_its_closed_form(stretch: float) -> None:
    sigma = stress_pa(np.diag([1.0, 1.0, stretch]))
    axial = (MU_PA * (stretch**2 - 1) + LAMBDA_PA * np.log(stretch)) / stretch
    lateral = LAMBDA_PA * np.log(stretch) / stretch
    assert sigma == pytest.approx(np.diag([lateral, lateral, axial]), abs=1e-9)
    assert von_mises_pa(sigma[None])[0] == pytest.approx(abs(axial - lateral))


@pytest.mark.parametrize("stretch", [0.8, 1.0, 1.2])
def test_hydrostatic_stretch_is_pressure_without_von_mises_stress(stretch: float) -> None:
    sigma = stress_pa(stretch * np.eye(3))
    pressure = (MU_PA * (stretch**2 - 1) + 3 * LAMBDA_PA * np.log(stretch)) / stretch**3
    assert sigma == pytest.approx(pressure * np.eye(3), abs=1e-9)
    assert von_mises_pa(sigma[None])[0] == pytest.approx(0.0, abs=1e-8)


def test_simple_shear_has_the_neo_hookean_shear_and_normal_stress() -> None:
    shear = 0.3
    sigma = stress_pa(np.array([[1.0, shear, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]))
    expected = MU_PA * np.array([[shear**2, shear, 0.0], [shear, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert sigma == pytest.approx(expected, abs=1e-9)
    assert von_mises_pa(sigma[None])[0] == pytest.approx(MU_PA * np.sqrt(shear**4 + 3 * shear**2))


def test_small_strain_has_youngs_modulus_and_poisson_ratio() -> None:
    strain = 1e-6
    sigma = stress_pa(np.diag([1 - NU * strain, 1 - NU * strain, 1 + strain]))
    assert sigma[2, 2] / strain == pytest.approx(E_PA, rel=1e-4)
    assert sigma[0, 0] / strain == pytest.approx(0.0, abs=1.0)


def test_stress_is_the_derivative_of_the_energy() -> None:
    F = np.array([[1.1, 0.2, 0.0], [-0.1, 0.9, 0.05], [0.0, 0.1, 1.2]])
    step = 1e-6
    P = np.zeros((3, 3))
    for i, j in np.ndindex(3, 3):
        change = np.zeros((3, 3))
        change[i, j] = step
        P[i, j] = (energy_density(F + change) - energy_density(F - change)) / (2 * step)
    assert stress_pa(F) == pytest.approx(P @ F.T / np.linalg.det(F), rel=1e-5, abs=1.0)


def test_rotation_turns_the_stress_and_leaves_von_mises_alone() -> None:
    F = np.diag([0.9, 1.0, 1.2])
    Q = rotation_about((1.0, 2.0, -0.5), 0.8)
    sigma, turned = stress_pa(F), stress_pa(Q @ F)
    assert turned == pytest.approx(Q @ sigma @ Q.T, abs=1e-8)
    assert von_mises_pa(turned[None])[0] == pytest.approx(von_mises_pa(sigma[None])[0])


def test_von_mises_of_pure_tension_is_the_tension() -> None:
    assert von_mises_pa(np.diag([0.0, -7.0, 0.0])[None])[0] == pytest.approx(7.0)


def square_surface() -> tuple[FloatArray, np.ndarray]:
    """Two triangles in the plane z = 0."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float64)
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def test_contact_pressure_is_the_stress_along_the_normal() -> None:
    corners, triangles = square_surface()
    stress = np.broadcast_to(np.diag([-7.0, 9.0, -2.5]), (4, 3, 3))
    assert contact_pressure_pa(stress, corners, triangles) == pytest.approx(np.full(4, 2.5))
    assert contact_pressure_pa(stress, corners, triangles[:, ::-1]) == pytest.approx(np.full(4, 2.5))


def test_contact_pressure_is_none_where_the_surface_is_pulled_or_has_no_triangle() -> None:
    corners, triangles = square_surface()
    pulled = np.broadcast_to(np.diag([-7.0, -7.0, 2.5]), (4, 3, 3))
    assert contact_pressure_pa(pulled, corners, triangles) == pytest.approx(np.zeros(4))
    pressed = np.broadcast_to(-np.eye(3), (4, 3, 3))
    assert contact_pressure_pa(pressed, corners, triangles[:1]) == pytest.approx([1.0, 1.0, 1.0, 0.0])


def test_contact_pressure_turns_with_the_surface() -> None:
    corners, triangles = square_surface()
    Q = rotation_about((0.3, -1.0, 2.0), 1.1)
    stress = np.diag([1.0, 2.0, -4.0]) + 0.5
    turned = contact_pressure_pa(np.broadcast_to(Q @ stress @ Q.T, (4, 3, 3)), corners @ Q.T, triangles)
    assert turned == pytest.approx(np.full(4, 3.5))


def test_nodal_means_of_tensors_are_those_of_their_parts() -> None:
    gel = gelsight_mini_mesh()
    tensors = np.random.default_rng(4).normal(size=(320, 3, 3))
    means = nodal_means(tensors, gel.rest_position_m, gel.tetrahedra)
    assert means.shape == (162, 3, 3)
    assert means[:, 1, 2] == pytest.approx(nodal_means(tensors[:, 1, 2], gel.rest_position_m, gel.tetrahedra))


def test_nodal_means_keep_a_constant_and_weigh_by_volume() -> None:
    gel = gelsight_mini_mesh()
    constant = nodal_means(np.full(320, 4.5), gel.rest_position_m, gel.tetrahedra)
    assert constant == pytest.approx(np.full(162, 4.5))
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -3]], dtype=np.float64)
    two = np.array([[0, 1, 2, 3], [0, 2, 1, 4]])
    means = nodal_means(np.array([1.0, 5.0]), corners, two)
    assert means == pytest.approx([4.0, 4.0, 4.0, 1.0, 5.0])


def test_displacement_ignores_the_pose_and_counts_what_is_pressed_in() -> None:
    gel = gelsight_mini_mesh()
    rotation, centre = rotation_about((0.2, -1.0, 0.3), 1.1), np.array([0.02, -0.5, 0.1])
    pressed = gel.rest_position_m.copy()
    pressed[gel.sensing, 2] -= 8e-4
    found = displacement_m(gel.rest_position_m, pressed @ rotation.T + centre, rotation, centre)
    assert found[gel.sensing] == pytest.approx(8e-4)
    assert found[~gel.sensing] == pytest.approx(0.0, abs=1e-15)
