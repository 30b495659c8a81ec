"""One look of the rig: its pictures belong together, and none depends on which others are asked for."""

import numpy as np
import pytest
from numpy.typing import NDArray
from visible_scenes import STARTS, fusion_scene
from vitac.envs.vision.camera import DepthMode, RigCamera, Sight
from vitac.envs.vision.rasterizer import Body, Label, VerticesDoNotFit

SCENE = fusion_scene(STARTS[4])
PICTURES = ("colours", "depth_m", "segmentation", "point_cloud_m")


def look(depth_mode: DepthMode = DepthMode.GT, seed: int = 0) -> Sight:
    return Sight(
        SCENE.surfaces,
        SCENE.vertices_m,
        pose=SCENE.pose,
        depth_mode=depth_mode,
        random=np.random.default_rng(seed),
    )


def test_colour_depth_and_segmentation_show_the_same_pixels() -> None:
    sight = look()
    is_seen = sight.segmentation != Label.NOTHING
    np.testing.assert_array_equal(sight.depth_m > 0.0, is_seen)
    np.testing.assert_array_equal((sight.colours == 255).all(axis=2), ~is_seen)
    assert 0.03 < is_seen.mean() < 0.5


@pytest.mark.parametrize("depth_mode", DepthMode)
def test_cloud_and_object_points_are_those_of_the_depth_picture(depth_mode: DepthMode) -> None:
    sight = look(depth_mode)
    np.testing.assert_array_equal(sight.point_cloud_m[:, :, 2], sight.depth_m)
    known = {tuple(point) for point in sight.point_cloud_m[sight.segmentation == Label.PEG].tolist()}
    assert {tuple(point) for point in sight.objects.points_m[0].tolist()} <= known


@pytest.mark.parametrize("depth_mode", DepthMode)
def test_pictures_do_not_depend_on_the_order_in_which_they_are_asked_for(depth_mode: DepthMode) -> None:
    forward, backward = look(depth_mode), look(depth_mode)
    first = {name: getattr(forward, name) for name in PICTURES}
    objects = backward.objects
    again = {name: getattr(backward, name) for name in reversed(PICTURES)}
    for name in PICTURES:
        np.testing.assert_array_equal(first[name], again[name])
    np.testing.assert_array_equal(forward.objects.points_m, objects.points_m)


@pytest.mark.parametrize("depth_mode", DepthMode)
def test_a_look_draws_the_same_numbers_whatever_it_sees(depth_mode: DepthMode) -> None:
    """Else what a policy asks for would change the episode."""
    left_over = []
    for vertices_m in (SCENE.vertices_m, SCENE.vertices_m + 100.0):
        random = np.random.default_rng(7)
        sight = Sight(SCENE.surfaces, vertices_m, pose=SCENE.pose, depth_mode=depth_mode, random=random)
        left_over.append(random.random())
        assert sight.segmentation.any() == (vertices_m is SCENE.vertices_m)
    assert left_over[0] == left_over[1]


def test_asking_for_pictures_draws_nothing() -> None:
    random = np.random.default_rng(7)
    sight = Sight(SCENE.surfaces, SCENE.vertices_m, pose=SCENE.pose, depth_mode=DepthMode.STEREO, random=random)
    before = random.bit_generator.state
    assert sight.objects.peg_seen
    assert sight.colours.shape == (480, 640, 3)
    assert random.bit_generator.state == before


def test_exact_depth_has_no_noise_and_measured_depth_has() -> None:
    np.testing.assert_array_equal(look(seed=1).depth_m, look(seed=2).depth_m)
    first, second = look(DepthMode.STEREO, seed=1).depth_m, look(DepthMode.STEREO, seed=2).depth_m
    assert (first != second).any()
    np.testing.assert_array_equal(look(DepthMode.STEREO, seed=1).depth_m, first)


def test_measured_depth_is_close_to_the_exact_one() -> None:
    exact, measured = look().depth_m, look(DepthMode.STEREO).depth_m
    both = (exact > 0.0) & (measured > 0.0)
    assert both.sum() > 0.9 * (exact > 0.0).sum()
    assert np.median(np.abs(measured[both] - exact[both])) < 2e-3
    assert not measured[exact == 0.0].any()


def test_infrared_pictures_do_not_depend_on_where_depth_comes_from() -> None:
    exact, measured = look(DepthMode.GT).infrared, look(DepthMode.STEREO).infrared
    np.testing.assert_array_equal(exact.left, measured.left)
    np.testing.assert_array_equal(exact.right, measured.right)


def test_an_empty_scene_is_a_white_picture_without_depth() -> None:
    sight = Sight(
        SCENE.surfaces,
        SCENE.vertices_m + 100.0,
        pose=SCENE.pose,
        depth_mode=DepthMode.STEREO,
        random=np.random.default_rng(0),
    )
    assert (sight.colours == 255).all()
    assert not sight.depth_m.any()
    assert not sight.point_cloud_m.any()
    assert (sight.objects.peg_seen, sight.objects.base_seen) == (False, False)


def rig() -> RigCamera:
    triangle = np.array([[0, 1, 2]])
    bodies = [Body(vertex_count=3, triangles=triangle, label=label) for label in (Label.BASE, Label.PEG)]
    return RigCamera(bodies, DepthMode.GT)


def in_front(distance_m: float) -> NDArray[np.float64]:
    """A triangle across the optical axis that looks at the camera, in the world [m]."""
    corners_m = np.array([[-0.05, -0.05, distance_m], [0.0, 0.05, distance_m], [0.05, -0.05, distance_m]])
    return corners_m @ SCENE.pose.world_from_camera.T + SCENE.pose.position_m


@pytest.mark.parametrize(("base_m", "peg_m", "seen"), [(0.3, 0.4, Label.BASE), (0.4, 0.3, Label.PEG)])
def test_the_nearer_body_hides_the_other(base_m: float, peg_m: float, seen: Label) -> None:
    sight = rig().look([in_front(base_m), in_front(peg_m)], SCENE.pose, np.random.default_rng(0))
    assert sight.segmentation[230, 317] == seen
    assert sight.depth_m[230, 317] == pytest.approx(0.3, abs=1e-6)


def test_vertices_of_other_bodies_are_refused() -> None:
    with pytest.raises(VerticesDoNotFit):
        rig().look([in_front(0.3)], SCENE.pose, np.random.default_rng(0))
