import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from visible_scenes import random_rotation
from vitac.envs.vision.back_projection import point_cloud, rays
from vitac.envs.vision.pinhole import CameraPose

seeds = given(st.integers(0, 10**6))
some = settings(max_examples=30)


def random_pose(random: np.random.Generator) -> CameraPose:
    return CameraPose(world_from_camera=random_rotation(random), position_m=random.normal(size=3))


@some
@seeds
def test_distances_are_the_same_in_every_frame(seed: int) -> None:
    random = np.random.default_rng(seed)
    pose, points_m = random_pose(random), random.normal(size=(6, 3))
    seen_m = pose.transform_to_camera(points_m)
    assert np.linalg.norm(seen_m, axis=1) == pytest.approx(np.linalg.norm(points_m - pose.position_m, axis=1))
    assert seen_m @ pose.world_from_camera.T + pose.position_m == pytest.approx(points_m)


def test_axes_of_a_camera_are_right_down_and_forward() -> None:
    pose = random_pose(np.random.default_rng(3))
    ahead_m = pose.position_m + pose.world_from_camera.T
    assert pose.transform_to_camera(ahead_m) == pytest.approx(np.eye(3))


@some
@seeds
def test_a_camera_moved_right_sees_everything_further_left(seed: int) -> None:
    random = np.random.default_rng(seed)
    pose, points_m, distance_m = random_pose(random), random.normal(size=(6, 3)), float(random.normal())
    seen_m = pose.moved_right(distance_m).transform_to_camera(points_m)
    assert seen_m - pose.transform_to_camera(points_m) == pytest.approx(np.tile([-distance_m, 0.0, 0.0], (6, 1)))
    back = pose.moved_right(distance_m).moved_right(-distance_m)
    assert back.position_m == pytest.approx(pose.position_m)


def test_no_points_are_no_error() -> None:
    assert random_pose(np.random.default_rng(0)).transform_to_camera(np.empty((0, 3))).shape == (0, 3)


@some
@given(st.integers(0, 10**6), st.floats(50.0, 2000.0), st.floats(50.0, 2000.0), st.floats(-5.0, 15.0))
def test_points_of_a_depth_picture_project_back_to_their_pixels(
    seed: int, focal_u_px: float, focal_v_px: float, centre_px: float
) -> None:
    depth_m = np.random.default_rng(seed).uniform(0.1, 3.0, (5, 7)).astype(np.float32)
    x, y, z = np.moveaxis(point_cloud(depth_m, (focal_u_px, focal_v_px, centre_px, 2.0)).astype(np.float64), 2, 0)
    np.testing.assert_array_equal(z, depth_m)
    assert focal_u_px * x / z + centre_px == pytest.approx(np.tile(np.arange(7) + 0.5, (5, 1)), abs=1e-3)
    assert focal_v_px * y / z + 2.0 == pytest.approx(np.tile(np.arange(5) + 0.5, (7, 1)).T, abs=1e-3)


def test_points_of_a_plane_across_the_axis_are_evenly_spaced() -> None:
    cloud = point_cloud(np.full((4, 6), 2.0, np.float32), (100.0, 50.0, 3.0, 2.0))
    assert np.diff(cloud[:, :, 0], axis=1) == pytest.approx(0.02)
    assert np.diff(cloud[:, :, 1], axis=0) == pytest.approx(0.04)
    assert cloud.mean(axis=(0, 1)) == pytest.approx([0.0, 0.0, 2.0], abs=1e-6)


def test_the_ray_of_the_principal_point_is_the_axis() -> None:
    x, y = rays(np.array([3, 4]), np.array([7]), (100.0, 50.0, 3.5, 7.5))
    assert x.tolist() == [0.0, 0.01]
    assert y.tolist() == [0.0]
