"""The camera rig stands where the challenge puts it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from visible_scenes import STARTS, fusion_scene, random_rotation
from vitac.envs.vision.look import colour_picture, depth_picture, segmentation_picture
from vitac.envs.vision.optics import COLOUR_INTRINSICS, INFRARED_INTRINSICS, point_cloud, rays
from vitac.envs.vision.pinhole import (
    BASELINE_M,
    LEFT_INFRARED_X_M,
    RIGHT_INFRARED_X_M,
    CameraPose,
    RigShift,
    base_pixels,
    colour_camera_pose,
    draw_points,
    object_clouds,
    peg_pixels,
)
from vitac.envs.vision.rasterizer import Label

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


def test_camera_looks_down_at_the_peg_with_its_picture_upside_down() -> None:
    pose = colour_camera_pose(0.03, 0.025)
    right, down, forward = pose.world_from_camera.T
    assert forward == pytest.approx([-0.8064, 0.0, -0.5913], abs=1e-4)
    assert -down[2] == pytest.approx(-0.8064, abs=1e-4)
    assert right == pytest.approx([0.0, -1.0, 0.0])
    assert np.cross(right, down) == pytest.approx(forward)
    assert pose.position_m == pytest.approx([0.371, 0.05, 0.275])


def test_camera_follows_the_peg_in_y_and_z_only() -> None:
    moved = colour_camera_pose(0.04, 0.02).position_m - colour_camera_pose(0.03, 0.025).position_m
    assert moved == pytest.approx([0.0, 0.01, -0.005])


def test_a_shift_turns_and_moves_the_rig() -> None:
    pose = colour_camera_pose(0.03, 0.025, RigShift(turn_rad=0.04, offset_m=(0.01, -0.02, 0.005)))
    nominal = colour_camera_pose(0.03, 0.025)
    cosine = float(pose.world_from_camera[:, 2] @ nominal.world_from_camera[:, 2])
    assert np.arccos(cosine) == pytest.approx(0.04)
    assert pose.position_m - nominal.position_m == pytest.approx([0.01, -0.02, 0.005])


def test_infrared_cameras_are_55_mm_apart_and_see_32_78_pixels_of_disparity_at_one_metre() -> None:
    assert abs(BASELINE_M - 0.055023) < 1e-6
    pose = colour_camera_pose(0.0, 0.0)
    point = pose.position_m + pose.world_from_camera @ [0.01, 0.02, 1.0]
    columns = [
        INFRARED_INTRINSICS.focal_u_px
        * camera.transform_to_camera(point[None])[0, 0]
        / camera.transform_to_camera(point[None])[0, 2]
        for camera in (pose.moved_right(LEFT_INFRARED_X_M), pose.moved_right(RIGHT_INFRARED_X_M))
    ]
    assert columns[0] - columns[1] == pytest.approx(32.78, abs=0.005)


def test_colour_camera_sees_56_degrees_across() -> None:
    assert 2 * np.degrees(np.arctan(320 / COLOUR_INTRINSICS.focal_u_px)) == pytest.approx(55.8, abs=0.05)


SCENE = fusion_scene(STARTS[1])
VIEW = SCENE.view()
COLOURS, DEPTH_M = colour_picture(VIEW, SCENE.surfaces, SCENE.vertices_m), depth_picture(VIEW)

DRAWS = draw_points(np.random.default_rng(0))


def in_world(points_m: np.ndarray) -> np.ndarray:
    return np.asarray(points_m @ SCENE.pose.world_from_camera.T + SCENE.pose.position_m)


def test_a_point_is_its_pixels_ray_at_its_depth() -> None:
    cloud = point_cloud(DEPTH_M, COLOUR_INTRINSICS)
    assert cloud.shape == (480, 640, 3)
    assert cloud.dtype == np.float32
    row, column = np.argwhere(DEPTH_M > 0)[500]
    x, y, z = cloud[row, column].astype(np.float64)
    assert z == DEPTH_M[row, column]
    assert COLOUR_INTRINSICS.focal_u_px * x / z + COLOUR_INTRINSICS.centre_u_px == pytest.approx(column + 0.5, abs=1e-3)
    assert COLOUR_INTRINSICS.focal_v_px * y / z + COLOUR_INTRINSICS.centre_v_px == pytest.approx(row + 0.5, abs=1e-3)


def test_points_of_the_base_lie_on_it() -> None:
    """Its upper faces lie at heights 17.4, 17, 4.4 and 0 mm; all else is between them."""
    cloud = in_world(point_cloud(DEPTH_M, COLOUR_INTRINSICS)[segmentation_picture(VIEW, SCENE.surfaces) == Label.BASE])
    assert cloud[:, 2].max() == pytest.approx(0.0174, abs=1e-6)
    assert cloud[:, 2].min() > -0.0026
    on_rim = np.abs(cloud[:, 2] - 0.0174) < 1e-6
    assert on_rim.mean() > 0.1


def test_unknown_pixels_are_zeros() -> None:
    cloud = point_cloud(DEPTH_M, COLOUR_INTRINSICS)
    assert (cloud[DEPTH_M == 0] == 0).all()


def test_the_object_clouds_are_drawn_from_their_objects_pixels() -> None:
    clouds = object_clouds(COLOURS, DEPTH_M, COLOUR_INTRINSICS, DRAWS)
    cloud = point_cloud(DEPTH_M, COLOUR_INTRINSICS)
    label = segmentation_picture(VIEW, SCENE.surfaces)
    assert clouds.points_m.shape == (2, 128, 3)
    assert clouds.points_m.dtype == np.float32
    assert (clouds.peg_seen, clouds.base_seen) == (True, True)
    for points, name in zip(clouds.points_m, (Label.PEG, Label.BASE), strict=True):
        known = {tuple(point) for point in cloud[label == name].tolist()}
        assert {tuple(point) for point in points.tolist()} <= known
        assert len({tuple(point) for point in points.tolist()}) > 100


def test_pixels_without_depth_never_enter_a_cloud() -> None:
    depth_m = DEPTH_M.copy()
    depth_m[:, ::2] = 0
    depth_m[::2] = 0
    clouds = object_clouds(COLOURS, depth_m, COLOUR_INTRINSICS, DRAWS)
    assert (clouds.points_m[:, :, 2] > 0.3).all()


def test_an_object_out_of_sight_gives_zeros_and_a_flag() -> None:
    without_peg = np.where(peg_pixels(COLOURS), np.float32(0), DEPTH_M)
    clouds = object_clouds(COLOURS, without_peg, COLOUR_INTRINSICS, DRAWS)
    assert (clouds.peg_seen, clouds.base_seen) == (False, True)
    assert (clouds.points_m[0] == 0).all()
    assert (clouds.points_m[1, :, 2] > 0).all()


def test_the_points_of_an_object_do_not_depend_on_the_other() -> None:
    full = object_clouds(COLOURS, DEPTH_M, COLOUR_INTRINSICS, DRAWS)
    without_peg = np.where(peg_pixels(COLOURS), np.float32(0), DEPTH_M)
    half = object_clouds(COLOURS, without_peg, COLOUR_INTRINSICS, DRAWS)
    np.testing.assert_array_equal(half.points_m[1], full.points_m[1])


def test_no_pixel_is_peg_and_base() -> None:
    colours = np.random.default_rng(0).integers(0, 256, (200, 200, 3)).astype(np.uint8)
    assert not (peg_pixels(colours) & base_pixels(colours)).any()
