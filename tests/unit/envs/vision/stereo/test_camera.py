"""Stereo depth of the task at the challenge's 50 starts: how much is measured, and how well."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from visible_scenes import STARTS, SeenScene, fusion_scene
from vitac.envs.vision.pictures import segmentation_picture
from vitac.envs.vision.stereo.camera import InfraredPair, depth_of_pair, draw_noise_keys, infrared_pair
from vitac.envs.vision.surfaces import Body, Label, VisibleSurfaces


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
