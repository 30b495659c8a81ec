"""Clouds lie on the bodies that were seen, hold no unknown pixel, and an object that is out of sight is no error."""

import numpy as np
import pytest
from visible_scenes import STARTS, fusion_scene
from vitac.envs.vision.back_projection import point_cloud
from vitac.envs.vision.optics import COLOUR_INTRINSICS
from vitac.envs.vision.pictures import colour_picture, depth_picture, segmentation_picture
from vitac.envs.vision.point_cloud import base_pixels, draw_points, object_clouds, peg_pixels
from vitac.envs.vision.surfaces import Label

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
