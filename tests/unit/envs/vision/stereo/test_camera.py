"""Stereo depth of the task at the challenge's 50 starts: how much is measured, and how well."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from visible_scenes import STARTS, SeenScene, fusion_scene
from vitac.envs.vision.look import segmentation_picture
from vitac.envs.vision.optics import COLOUR_INTRINSICS, INFRARED_INTRINSICS
from vitac.envs.vision.pinhole import BASELINE_M, LEFT_INFRARED_X_M
from vitac.envs.vision.rasterizer import Body, Label, VisibleSurfaces
from vitac.envs.vision.stereo.camera import (
    InfraredPair,
    depth_of_pair,
    draw_noise_keys,
    infrared_pair,
    registered_depth_m,
)
from vitac.envs.vision.stereo.matching import PARTS


def pair_of(scene: SeenScene, seed: int) -> InfraredPair:
    keys = draw_noise_keys(np.random.default_rng(seed))
    return infrared_pair(scene.surfaces, scene.vertices_m, pose=scene.pose, colour_view=scene.view(), noise_keys=keys)


def stereo(scene: SeenScene, seed: int) -> NDArray[np.float32]:
    return depth_of_pair(pair_of(scene, seed), scene.view())


@cache
def errors_mm(label: Label) -> tuple[float, NDArray[np.float64]]:
    """Share of a body's pixels that have a depth, and how far it is off [mm], over all starts."""
    errors, pixels = [], 0
    for seed, start in enumerate(STARTS):
        scene = fusion_scene(start)
        view = scene.view()
        depth_m = stereo(scene, seed)
        shown = segmentation_picture(view, scene.surfaces) == label
        measured = shown & (depth_m > 0)
        errors.append((depth_m[measured] - view.depth_m[measured]) * 1e3)
        pixels += int(shown.sum())
    joined = np.concatenate(errors)
    return len(joined) / pixels, joined


def test_the_peg_is_measured_nearly_everywhere_and_without_bias() -> None:
    valid, error_mm = errors_mm(Label.PEG)
    assert valid >= 0.95
    assert np.median(np.abs(error_mm)) <= 1.2
    assert abs(np.median(error_mm)) <= 0.5
    assert abs(error_mm.mean()) <= 0.5


def test_the_base_is_measured_but_for_where_the_peg_hides_it() -> None:
    valid, error_mm = errors_mm(Label.BASE)
    assert valid >= 0.88
    assert np.median(np.abs(error_mm)) <= 1.5


@pytest.mark.parametrize("start", STARTS[:10])
def test_the_background_is_never_measured(start: tuple[float, float, float, float, int]) -> None:
    scene = fusion_scene(start)
    assert (stereo(scene, 0)[scene.view().triangle < 0] == 0).all()


def test_noise_is_the_generators() -> None:
    scene = fusion_scene(STARTS[0])
    np.testing.assert_array_equal(stereo(scene, 1), stereo(scene, 1))
    assert (stereo(scene, 1) != stereo(scene, 2)).any()


def behind_the_camera() -> SeenScene:
    scene = fusion_scene(STARTS[0])
    surfaces = VisibleSurfaces([Body(vertex_count=3, triangles=np.array([[0, 1, 2]]), label=Label.PEG)])
    behind_m = scene.pose.position_m + np.array([[0.1, 0, 0], [0.2, 0.1, 0], [0.2, 0, 0.1]])
    return SeenScene(surfaces=surfaces, vertices_m=behind_m, pose=scene.pose)


def test_nothing_in_front_of_the_camera_gives_an_empty_picture() -> None:
    depth_m = stereo(behind_the_camera(), 0)
    assert depth_m.shape == (480, 640)
    assert depth_m.dtype == np.float32
    assert (depth_m == 0).all()


def test_objects_at_the_left_edge_of_the_picture_are_not_matched_beyond_it() -> None:
    """Their partners lie left of the right picture's first column."""
    scene = fusion_scene(STARTS[0])
    pair = pair_of(scene, 0)
    shifted = type(pair)(left=np.roll(pair.left, -270, axis=1), right=np.roll(pair.right, -270, axis=1))
    shifted.right[:, 400:] = 0
    assert depth_of_pair(shifted, scene.view()).shape == (480, 640)


SHOWN = np.zeros((480, 640), np.int32)
PER_DISPARITY_M = INFRARED_INTRINSICS.focal_u_px * BASELINE_M


def one_point(row: int, column: int, disparity: int, shown: NDArray[np.int32] = SHOWN) -> NDArray[np.float32]:
    return registered_depth_m(np.array([[disparity * PARTS]], np.int32), row, column, shown)


def test_a_point_lands_where_the_colour_camera_sees_it() -> None:
    depth_m = one_point(300, 350, 70)
    z = PER_DISPARITY_M / 70
    x = (350.5 - INFRARED_INTRINSICS.centre_u_px) / INFRARED_INTRINSICS.focal_u_px * z + LEFT_INFRARED_X_M
    y = (300.5 - INFRARED_INTRINSICS.centre_v_px) / INFRARED_INTRINSICS.focal_v_px * z
    column = int(COLOUR_INTRINSICS.focal_u_px * x / z + COLOUR_INTRINSICS.centre_u_px)
    row = int(COLOUR_INTRINSICS.focal_v_px * y / z + COLOUR_INTRINSICS.centre_v_px)
    assert depth_m[row, column] == pytest.approx(z, abs=1e-7)
    assert np.argwhere(depth_m).tolist() == [[row, column]]


def test_a_plane_is_covered_without_gaps() -> None:
    found = np.full((60, 80), 70 * PARTS, np.int32)
    depth_m = registered_depth_m(found, 200, 300, SHOWN)
    rows, columns = np.nonzero(depth_m)
    covered = depth_m[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    assert covered.shape[0] >= 60
    assert covered.shape[1] >= 80
    assert covered == pytest.approx(np.full(covered.shape, PER_DISPARITY_M / 70), abs=1e-7)


def test_of_two_points_in_a_pixel_the_nearer_counts() -> None:
    """In a row of rising disparities, columns fold over each other."""
    wall = registered_depth_m(np.array([[60 * PARTS] * 30 + [95 * PARTS] * 30], np.int32), 250, 300, SHOWN)
    near = one_point(250, 330, 95)
    assert (wall[near > 0] == near[near > 0]).all()


def test_gaps_are_filled_within_a_surface_and_not_beside_an_edge() -> None:
    """Columns without a match: on one plane, and where the background of a near plane is hidden."""

    def empty_columns(left: int, right: int, lost: int = 1) -> int:
        found = np.array([[left * PARTS] * 40 + [0] * lost + [right * PARTS] * 40] * 20, np.int32)
        depth_m = registered_depth_m(found, 200, 300, SHOWN)
        row = depth_m[np.nonzero(depth_m)[0].mean().astype(int)]
        first, *_, last = np.flatnonzero(row)
        return int((row[first : last + 1] == 0).sum())

    assert empty_columns(70, 70) == 0
    assert empty_columns(60, 80) > 0
    # Also where a single column is empty between two surfaces.
    assert 1 in {empty_columns(80, 60, lost) for lost in range(40)}


def test_the_background_has_no_depth() -> None:
    shown = np.full((480, 640), -1, np.int32)
    shown[:, 300:] = 0
    found = np.full((60, 80), 70 * PARTS, np.int32)
    depth_m = registered_depth_m(found, 200, 280, shown)
    assert (depth_m[:, :300] == 0).all()
    assert (depth_m[:, 300:] > 0).any()


def test_points_beyond_the_picture_are_dropped() -> None:
    found = np.full((12, 12), 70 * PARTS, np.int32)
    for row, column in ((-5, 300), (474, 300), (200, -40), (200, 634)):
        depth_m = registered_depth_m(found, row, column, SHOWN)
        assert depth_m.shape == (480, 640)
        assert ((depth_m == 0) | (depth_m == np.float32(PER_DISPARITY_M / 70))).all()


def test_no_disparity_gives_no_depth() -> None:
    assert (registered_depth_m(np.zeros((5, 5), np.int32), 200, 300, SHOWN) == 0).all()
