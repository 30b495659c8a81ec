"""The picture of a scene: everything is in it, gels have the colours of their values, and the peg is like glass."""

import matplotlib as mpl
import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.drawing.playback import EpisodePlayback
from vitac.envs.drawing.scene_view import (
    SceneImage,
    SceneView,
    cauchy_stress_pa,
    contact_pressure_pa,
    deformation_gradients,
    displacement_m,
    nodal_means,
    von_mises_pa,
)
from vitac.envs.tactile.gel import gelsight_mini_mesh
from vitac.envs.tasks.peg_insertion.definition import PERSPECTIVE

FloatArray = NDArray[np.float64]
WIDTH_PX, HEIGHT_PX = 240, 180
RED, BLUE = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)


def two_colours(values: FloatArray) -> FloatArray:
    return np.where(values[:, None] > 0.5, RED, BLUE)


def constant(playback: EpisodePlayback, left: float, right: float) -> tuple[FloatArray, FloatArray]:
    nodes = len(playback.gel.rest_position_m)
    return np.full(nodes, left), np.full(nodes, right)


@pytest.fixture
def view(peg_playback: EpisodePlayback) -> SceneView:
    return SceneView(peg_playback, PERSPECTIVE, width_px=WIDTH_PX, height_px=HEIGHT_PX)


@pytest.fixture
def image(view: SceneView, peg_playback: EpisodePlayback) -> SceneImage:
    return view.image(peg_playback.moments[0], constant(peg_playback, 1.0, 0.0), two_colours)


def test_picture_has_the_size_asked_for_and_a_white_edge(image: SceneImage) -> None:
    assert image.rgb.shape == (HEIGHT_PX, WIDTH_PX, 3)
    assert (image.rgb >= 0.0).all()
    assert (image.rgb <= 1.0).all()
    assert (image.rgb[0] == 1.0).all()
    assert (image.rgb[-1] == 1.0).all()
    assert (image.rgb[:, 0] == 1.0).all()
    assert (image.rgb[:, -1] == 1.0).all()


def test_the_scene_fills_the_picture_in_one_direction(image: SceneImage) -> None:
    rows, columns = np.nonzero((image.rgb < 1.0).any(axis=2))
    assert max(np.ptp(rows) / HEIGHT_PX, np.ptp(columns) / WIDTH_PX) > 0.8


@pytest.mark.parametrize(("width_px", "height_px"), [(80, 240), (400, 120)])
def test_the_scene_fits_narrow_and_flat_pictures(peg_playback: EpisodePlayback, width_px: int, height_px: int) -> None:
    narrow = SceneView(peg_playback, PERSPECTIVE, width_px=width_px, height_px=height_px)
    rgb = narrow.image(peg_playback.moments[0], constant(peg_playback, 1.0, 0.0), two_colours).rgb
    rows, columns = np.nonzero((rgb < 1.0).any(axis=2))
    assert 0 < rows.min() < rows.max() < height_px - 1
    assert 0 < columns.min() < columns.max() < width_px - 1
    assert max(np.ptp(rows) / height_px, np.ptp(columns) / width_px) > 0.75


def test_every_line_lies_within_the_picture(view: SceneView, peg_playback: EpisodePlayback) -> None:
    for moment in peg_playback.moments:
        image = view.image(moment, constant(peg_playback, 0.0, 0.0), two_colours)
        lines = [*image.lines, *image.faint_lines, *image.element_lines, *image.cut_lines]
        assert len(lines) > 100
        points = np.concatenate(lines)
        assert (points >= 0.0).all()
        assert (points <= [WIDTH_PX, HEIGHT_PX]).all()


def test_each_gel_has_the_colour_of_its_own_values(image: SceneImage) -> None:
    is_red = (image.rgb[:, :, 0] > 0.6) & (image.rgb[:, :, 2] < 0.05)
    is_blue = (image.rgb[:, :, 2] > 0.6) & (image.rgb[:, :, 0] < 0.05)
    for where, (low, high) in zip((is_red, is_blue), image.gel_boxes, strict=True):
        rows, columns = np.nonzero(where)
        assert len(rows) > 50
        assert (np.floor(low) <= [columns.min(), rows.min()]).all()
        assert (np.ceil(high) >= [columns.max(), rows.max()]).all()


def test_a_value_at_some_nodes_colours_that_part_of_the_gel(view: SceneView, peg_playback: EpisodePlayback) -> None:
    along = peg_playback.gel.rest_position_m[:, 0]
    half = np.where(along > 0.0, 1.0, 0.0)
    image = view.image(peg_playback.moments[0], (half, half), two_colours)
    is_red = (image.rgb[:, :, 0] > 0.6) & (image.rgb[:, :, 2] < 0.05)
    is_blue = (image.rgb[:, :, 2] > 0.6) & (image.rgb[:, :, 0] < 0.05)
    assert min(is_red.sum(), is_blue.sum()) > 50
    # The gels' x points down in the world.
    assert np.nonzero(is_red)[0].mean() > np.nonzero(is_blue)[0].mean() + 5


def test_values_change_colours_and_nothing_else(
    view: SceneView, peg_playback: EpisodePlayback, image: SceneImage
) -> None:
    swapped = view.image(peg_playback.moments[0], constant(peg_playback, 0.0, 1.0), two_colours)
    np.testing.assert_allclose(swapped.rgb[:, :, 1], image.rgb[:, :, 1], atol=1e-12)
    assert (swapped.rgb != image.rgb).any()
    np.testing.assert_array_equal(swapped.gel_boxes, image.gel_boxes)
    assert [line.tolist() for line in swapped.lines] == [line.tolist() for line in image.lines]


def test_a_moment_looks_the_same_whatever_was_drawn_before(view: SceneView, peg_playback: EpisodePlayback) -> None:
    values, colours = constant(peg_playback, 0.3, 0.8), mpl.colormaps["viridis"]
    first = view.image(peg_playback.moments[0], values, colours).rgb
    other = view.image(peg_playback.moments[-1], values, colours).rgb
    assert (other != first).any()
    np.testing.assert_array_equal(view.image(peg_playback.moments[0], values, colours).rgb, first)


def test_the_held_part_is_drawn_where_it_goes(view: SceneView, peg_playback: EpisodePlayback) -> None:
    first, last = peg_playback.moments[0], peg_playback.moments[-1]
    values = constant(peg_playback, 0.0, 0.0)
    start, end = (view.image(moment, values, two_colours).held_middle for moment in (first, last))
    assert last.held_m[:, 2].mean() < first.held_m[:, 2].mean()
    assert end[1] > start[1], "the peg goes down, and so does its place in the picture"


def test_the_lowest_place_of_the_fixed_part_is_below_all_else(image: SceneImage) -> None:
    rows, _ = np.nonzero((image.rgb < 1.0).any(axis=2))
    assert image.fixed_bottom[1] == pytest.approx(rows.max(), abs=1.0)
    assert image.fixed_bottom[1] > image.gel_boxes[:, 1, 1].max()


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
