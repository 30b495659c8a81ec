from functools import cache

import numpy as np
import own_sensors
import pytest
from vitac.envs.scene.gripper import UPRIGHT_MOUNTS, SensorMount
from vitac.envs.tactile.camera import CameraMount
from vitac.envs.tactile.gel import arena_gel_mesh, gelsight_mini_mesh
from vitac.envs.tactile.markers import MarkerSettings, find_in_picture
from vitac.envs.tactile.response import Response, compute_response
from vitac.envs.tactile.sensor import NoReferenceCaptured, TactileSensor
from vitac.envs.tasks.lock_opening import env as lock


def sensor_and_view() -> tuple[TactileSensor, np.ndarray]:
    mesh = gelsight_mini_mesh()
    sensor = TactileSensor(mesh, MarkerSettings())
    return sensor, sensor.view_m(mesh.rest_position_m, np.eye(3), np.zeros(3))


def test_view_holds_the_sensing_nodes() -> None:
    _, view = sensor_and_view()
    assert view.shape == (49, 3)
    assert (view[:, 2] == 0.022).all()


def test_reading_before_the_reference_is_an_error() -> None:
    sensor, view = sensor_and_view()
    with pytest.raises(NoReferenceCaptured, match="after the grasp"):
        sensor.surface_diff_m(view)
    with pytest.raises(NoReferenceCaptured, match="capture_reference"):
        sensor.marker_flow(view, np.random.default_rng(0))


def test_surface_difference_is_the_mean_distance_to_the_reference() -> None:
    sensor, view = sensor_and_view()
    sensor.capture_reference(view)
    assert sensor.surface_diff_m(view) == 0.0
    assert sensor.surface_diff_m(view + np.array([0.0, 3e-4, 4e-4])) == pytest.approx(5e-4)


def test_marker_flow_compares_with_the_reference() -> None:
    sensor, view = sensor_and_view()
    sensor.capture_reference(view + np.array([1e-3, 0.0, 0.0]))
    flow = sensor.marker_flow(view, np.random.default_rng(0))
    assert (flow[1] - flow[0])[:40, 0].mean() == pytest.approx(-340 / 22, abs=0.3)


def test_a_camera_that_is_mounted_otherwise_sees_the_same_markers_elsewhere() -> None:
    sensor, view = sensor_and_view()
    sensor.capture_reference(view)
    sensor.settings = MarkerSettings(noise_px=0.0)
    ideal = sensor.marker_flow(view, np.random.default_rng(1))
    sensor.mount = CameraMount(shift_u_px=2.0, shift_v_px=-1.0, turn_deg=90.0, distortion=0.1)
    arm = (ideal - (160.0, 120.0)) * (1.0 + 0.1 * ((ideal - (160.0, 120.0)) ** 2).sum(axis=2, keepdims=True) / 200.0**2)
    turned = np.stack([-arm[..., 1], arm[..., 0]], axis=2)  # u becomes v
    assert sensor.marker_flow(view, np.random.default_rng(1)) == pytest.approx(turned + np.array((162.0, 119.0)))


def test_a_marker_that_has_left_the_picture_is_seen_only_as_the_challenge_does() -> None:
    flows = {}
    for sees_outside in (True, False):
        sensor, view = sensor_and_view()
        sensor.settings, sensor.sees_outside = MarkerSettings(noise_px=0.0), sees_outside
        sensor.capture_reference(view)
        flows[sees_outside] = sensor.marker_flow(view - np.array([3e-3, 0.0, 0.0]), np.random.default_rng(0))
    left = ~find_in_picture(flows[True][1])
    assert left.any()
    assert find_in_picture(flows[False][1]).all()
    inside = flows[True][:, ~left]
    assert np.array_equal(flows[False][:, : inside.shape[1]], inside)


def test_motion_of_an_uneven_mesh_counts_by_area() -> None:
    mesh = arena_gel_mesh()
    sensor = TactileSensor(mesh, MarkerSettings())
    view = sensor.view_m(mesh.rest_position_m, np.eye(3), np.zeros(3))
    sensor.capture_reference(view)
    raised = view + 1e-3 * np.abs(view[:, :1]) * np.array([0.0, 0.0, 1.0])
    half_m = np.abs(view[:, 0]).max()
    assert sensor.surface_diff_m(raised) == pytest.approx(1e-3 * half_m / 2, rel=1e-12)


@pytest.mark.parametrize(
    ("mount", "u_direction", "v_direction"),
    [
        (UPRIGHT_MOUNTS[0], (0, 0, 1), (-1, 0, 0)),
        (UPRIGHT_MOUNTS[1], (0, 0, 1), (1, 0, 0)),
        (lock.MOUNTS[0], (-1, 0, 0), (0, 0, 1)),
        (lock.MOUNTS[1], (-1, 0, 0), (0, 0, -1)),
    ],
    ids=["peg left", "peg right", "lock left", "lock right"],
)
def test_image_axes_mean_the_stated_world_directions(
    mount: SensorMount, u_direction: tuple[int, ...], v_direction: tuple[int, ...]
) -> None:
    mesh = gelsight_mini_mesh()
    sensor = TactileSensor(mesh, MarkerSettings())
    nodes = mesh.rest_position_m @ mount.rotation.T
    for direction, axis in ((u_direction, 0), (v_direction, 1)):
        moved = nodes + 1e-3 * np.array(direction)
        still, shifted = (sensor.view_m(points, mount.rotation, np.zeros(3)) for points in (nodes, moved))
        expected = np.zeros(3)
        expected[axis] = 1e-3
        assert shifted - still == pytest.approx(np.tile(expected, (49, 1)))


def test_markers_that_an_observation_loses_are_those_that_are_not_in_it() -> None:
    mesh = gelsight_mini_mesh()
    settings = MarkerSettings(loss_probability=0.5, noise_px=0.0)
    sensor = TactileSensor(mesh, settings)
    view = sensor.view_m(mesh.rest_position_m, np.eye(3), np.zeros(3))
    sensor.capture_reference(view)
    seen = np.unique(sensor.marker_flow(view, np.random.default_rng(0))[0], axis=0)
    assert 10 < sensor.lost_px.shape[1] < 60
    everything = np.concatenate([seen, sensor.lost_px[0]])
    apart = np.linalg.norm(everything[:, None] - everything, axis=2)[~np.eye(len(everything), dtype=bool)]
    assert apart.min() > 20  # as a grid is: none twice


YOUNGS_MODULUS_PA, POISSON_RATIO = 3e5, 0.3


@cache
def response(youngs_modulus_pa: float = YOUNGS_MODULUS_PA) -> Response:
    return compute_response(
        own_sensors.designed("4 mm"), youngs_modulus_pa=youngs_modulus_pa, poisson_ratio=POISSON_RATIO
    )


def everywhere() -> np.ndarray:
    return np.ones((len(response().points_mm), 1))


def motion(of: Response, axis: int) -> np.ndarray:
    """Of all markers under 1 N along an axis that is spread over the whole face, shape [m, 2] [px]."""
    return np.asarray(of.motion_px_n(everywhere())[:, axis, 0].reshape(2, -1).T)


def test_places_share_out_the_area_of_the_sensing_faces() -> None:
    found = response()
    assert found.areas_mm2.sum() == pytest.approx(25.25 * 20.75, rel=1e-5)
    np.testing.assert_allclose(found.weights.sum(axis=1), 1.0)
    assert found.weights.min() >= 0.0
    centre_mm = (found.points_mm * found.areas_mm2[:, None]).sum(axis=0) / found.areas_mm2.sum()
    np.testing.assert_allclose(centre_mm, 0.0, atol=1e-9)


def test_shear_moves_markers_as_a_sheared_layer_does() -> None:
    """A wide layer under a shear stress moves by F h / (A G) at its face; near the rim of ours by more."""
    shear_modulus_pa = YOUNGS_MODULUS_PA / (2.0 * (1.0 + POISSON_RATIO))
    expected_m = 4e-3 / (25.25e-3 * 20.75e-3 * shear_modulus_pa)
    # The camera, 22 mm away, sees x and y the other way round.
    for axis, focal_px in ((0, 340.0), (1, 325.0)):
        along = np.median(motion(response(), axis)[:, axis])
        assert -along * 22e-3 / focal_px == pytest.approx(expected_m, rel=0.15)


def test_half_the_stiffness_gives_twice_the_motion() -> None:
    np.testing.assert_allclose(
        motion(response(0.5 * YOUNGS_MODULUS_PA), 2), 2.0 * motion(response(), 2), rtol=1e-9, atol=1e-15
    )


def test_each_pressure_is_scaled_to_1_n() -> None:
    found = response()
    both = found.motion_px_n(np.hstack([everywhere(), 7.0 * everywhere()]))
    np.testing.assert_allclose(both[:, :, 0], both[:, :, 1], rtol=1e-12)


def test_pin_moves_the_markers_around_it_most() -> None:
    found, markers = response(), own_sensors.designed("4 mm").markers_mm
    for place in (300, 700):
        load = np.eye(len(found.points_mm))[:, [place]]
        moved = found.motion_px_n(load)[:, 0, 0].reshape(2, -1)
        near = np.hypot(*(found.points_mm[place] - markers).T) < 3.0
        lengths = np.hypot(*moved)
        assert lengths[near].min() > np.median(lengths)
