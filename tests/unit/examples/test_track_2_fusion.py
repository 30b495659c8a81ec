"""The example of Track 2: what it sees in pictures of the task's starts, and what it does about a touch."""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from example_policies import flow, imported
from numpy.typing import NDArray
from visible_scenes import STARTS, fusion_scene
from vitac.envs.geometry.bases import hexagon_peg_surface
from vitac.envs.geometry.pegs import PegShape, peg_surface
from vitac.envs.vision.look import colour_picture, depth_picture, segmentation_picture
from vitac.envs.vision.pinhole import colour_camera_pose
from vitac.envs.vision.rasterizer import Label
from vitac.evaluator.submission.manifest import load_manifest

CUBOID, HEXAGON = STARTS[3], STARTS[4]


@pytest.fixture(scope="module")
def folder(repository: Path) -> Path:
    return repository / "examples" / "track_2_fusion" / "Track_2"


@pytest.fixture(scope="module")
def example(folder: Path) -> Iterator[SimpleNamespace]:
    with imported(folder) as modules:
        yield modules


@cache
def seen(start: tuple[float, float, float, float, int]) -> tuple[NDArray[np.uint8], NDArray[np.float32], Any]:
    """Colour, exact depth and labels at a start."""
    scene = fusion_scene(start)
    view = scene.view()
    colours = colour_picture(view, scene.surfaces, scene.vertices_m)
    return colours, depth_picture(view), segmentation_picture(view, scene.surfaces)


def true_place(start: tuple[float, float, float, float, int]) -> NDArray[np.float64]:
    x, y, theta, z, _ = start
    return np.array([x, y + 22.625, theta, z + 1.0])


def observation(
    start: tuple[float, float, float, float, int], motion: tuple[float, ...] = (0, 0, 0, 0), pressed: float = 0.0
) -> dict[str, Any]:
    """What the policy gets after a motion, with markers that were moved by so many pixels."""
    x, y, theta, z, left = start
    colours, depth, _ = seen((x + motion[0], y + motion[1], theta + motion[2], z + motion[3], left))
    moved = np.array([[pressed, 0.0], [0.0, 0.0], [0.0, 0.0]])
    return {
        "relative_motion": np.array(motion, dtype=np.float32),
        "rgb_picture": colours,
        "depth_picture": depth,
        "marker_flow": np.stack([flow(moved, 0.7, side) for side in (1, 2)]),
    }


def begun(example: SimpleNamespace) -> Any:
    policy = example.policy.Policy()
    policy.reset("fusion-insertion")
    return policy


def test_is_a_valid_submission_that_names_what_it_reads(folder: Path) -> None:
    manifest = load_manifest(folder)
    assert (manifest.track, manifest.tasks, manifest.entry_point) == ("track_2", ("fusion-insertion",), "policy:Policy")
    assert sorted(manifest.observation_keys or ()) == sorted(observation(STARTS[0]))


def test_camera_is_that_of_the_task(example: SimpleNamespace) -> None:
    points_mm = np.random.default_rng(0).uniform([-90, -60, -30], [40, 60, 60], (50, 3))
    y_mm, lower_end_mm = 12.0, 21.0
    pose = colour_camera_pose(y_mm * 1e-3, (lower_end_mm - 1.0) * 1e-3)
    in_camera_mm = pose.transform_to_camera((points_mm + np.array([0.0, y_mm, lower_end_mm])) * 1e-3) * 1e3
    expected = in_camera_mm[:, :2] / in_camera_mm[:, 2:] * 604.3075 + [317.2341, 233.7944]
    in_picture = example.camera.project(points_mm)
    assert in_picture == pytest.approx(expected)
    columns, rows = in_picture.T - 0.5
    assert example.camera.back_project(rows, columns, in_camera_mm[:, 2]) == pytest.approx(points_mm)


@pytest.mark.parametrize(
    ("shape", "surface"), [("hexagon", hexagon_peg_surface()), ("cuboid", peg_surface(PegShape.CUBOID))]
)
def test_pegs_are_those_of_the_task(example: SimpleNamespace, shape: str, surface: Any) -> None:
    corners_mm, vertices_mm = (
        sorted(given.round(3).tolist()) for given in (example.solids.PEGS[shape], surface.vertices_m * 1e3)
    )
    assert np.array(corners_mm) == pytest.approx(np.array(vertices_mm), abs=2e-3)


@pytest.mark.parametrize("start", STARTS[::5])
def test_colours_tell_peg_base_and_background(example: SimpleNamespace, start: Any) -> None:
    colours, depth, labels = seen(start)
    picture = example.picture.Picture(colours, depth)
    for mask, label in ((picture.peg, Label.PEG), (picture.base, Label.BASE), (picture.background, Label.NOTHING)):
        np.testing.assert_array_equal(mask, (labels == label)[example.picture.WINDOW])


@pytest.mark.parametrize("start", [(x, y, 0.0, z, 1) for x in (-5, 5) for y in (-32, 32) for z in (-3.5, 9)])
def test_window_holds_all_that_is_seen_on_the_way(example: SimpleNamespace, start: Any) -> None:
    labels = seen(start)[2].copy()
    labels[example.picture.WINDOW] = 0
    assert not labels.any()


@pytest.mark.parametrize("start", STARTS)
def test_shape_is_told_through_noise_and_holes_of_the_depth(example: SimpleNamespace, start: Any) -> None:
    colours, depth, _ = seen(start)
    random = np.random.default_rng(0)
    measured = depth + random.normal(0, 2e-3, depth.shape).astype(np.float32)
    measured[(depth == 0) | (random.random(depth.shape) < 0.3)] = 0
    assert example.picture.Picture(colours, measured).peg_shape() == ("hexagon" if start[4] else "cuboid")


@pytest.mark.parametrize("start", STARTS[::3])
def test_depth_gives_the_base_to_about_a_millimetre(example: SimpleNamespace, start: Any) -> None:
    colours, depth, _ = seen(start)
    assert np.abs(example.picture.Picture(colours, depth).rough_base_place() - true_place(start)[[1, 3]]).max() < 1.2


def test_pixels_without_depth_are_no_points(example: SimpleNamespace) -> None:
    colours, depth, _ = seen(STARTS[0])
    holes = depth.copy()
    holes[::2] = 0
    whole, half = (example.picture.Picture(colours, given) for given in (depth, holes))
    assert len(half.points(half.base)) == pytest.approx(len(whole.points(whole.base)) / 2, rel=0.05)
    assert np.abs(half.points(half.base)).max() < 200


@pytest.mark.parametrize("start", STARTS[::3])
def test_outlines_give_the_place_at_the_first_look(example: SimpleNamespace, start: Any) -> None:
    policy = begun(example)
    policy.act(observation(start))
    error = np.abs(policy.place(np.zeros(4)) - true_place(start))
    assert error[0] < 0.6
    assert error[1] < 0.15
    assert error[2] < 1.5
    assert error[3] < 0.5


@pytest.mark.parametrize("start", [CUBOID, HEXAGON])
def test_several_looks_give_it_better(example: SimpleNamespace, start: Any) -> None:
    policy = begun(example)
    for step in range(8):
        motion = (0.21 * step, 0.9 * step, -0.7 * step, -0.23 * step)
        policy.act(observation(start, motion))
    error = np.abs(policy.place(np.array(motion)) - true_place(start) - motion)
    assert len(policy.starts) == 8
    assert (error < [0.25, 0.05, 0.4, 0.3]).all()


def test_outline_of_the_wrong_angle_fits_worse(example: SimpleNamespace) -> None:
    start = CUBOID
    outline = example.picture.Picture(*seen(start)[:2]).peg_outline()
    misfits = [
        example.outline_fit.misfit(outline, example.solids.place_peg("cuboid", start[0], start[2] + off))
        for off in (0.0, 2.0, 6.0)
    ]
    assert misfits == sorted(misfits)
    assert misfits[0] < 0.3 < misfits[1]


def test_hull_leaves_out_what_lies_inside_or_on_an_edge(example: SimpleNamespace) -> None:
    inside = np.random.default_rng(0).uniform(1, 9, (30, 2)).tolist()
    points = [*inside, [0.0, 0.0], [10.0, 0.0], [5.0, 0.0], [10.0, 10.0], [0.0, 10.0]]
    assert sorted(example.outline_fit.convex_hull(points)) == [30, 31, 33, 34]


def test_every_point_has_its_nearest_edge_and_a_signed_distance(example: SimpleNamespace) -> None:
    ends = np.array([[[0.0, 0.0], [10.0, 0.0]], [[10.0, 0.0], [10.0, 10.0]]])
    points = np.array([[5.0, 1.0], [5.0, -1.0], [11.0, 5.0], [30.0, 9.0]])
    nearest = example.outline_fit.nearest_edges(points, ends)
    assert nearest.tolist() == [0, 0, 1, 1]
    assert example.outline_fit.from_lines(points, ends[nearest]).tolist() == [-1.0, 1.0, 1.0, 20.0]


def test_spiral_covers_the_hole_evenly(example: SimpleNamespace) -> None:
    points = np.array([example.policy.spiral(number) for number in range(12)])
    assert points[0].tolist() == [0.0, 0.0]
    apart = np.linalg.norm(points[:, None] - points, axis=2) + 9 * np.eye(12)
    assert apart.min() > 0.5
    grid = np.stack(np.meshgrid(np.linspace(-1.7, 1.7, 35), np.linspace(-1.7, 1.7, 35)), axis=-1).reshape(-1, 2)
    inside = grid[np.linalg.norm(grid, axis=1) < 1.7]
    assert np.linalg.norm(inside[:, None] - points, axis=2).min(axis=1).max() < 1.0


@pytest.mark.parametrize("seed", range(0, 20, 2))
def test_a_touch_is_told_from_the_markers_noise(example: SimpleNamespace, seed: int) -> None:
    still, pressed = (
        np.stack([flow(np.array([[shift, 0.0], [0, 0], [0, 0]]), 0.7, seed + side) for side in (0, 1)])
        for shift in (0.0, 3.0)
    )
    assert example.policy.marker_motion(still) < example.policy.TOUCH < example.policy.marker_motion(pressed)


@pytest.mark.parametrize("angle", [0.0, 30.0, -90.0])
def test_action_goes_straight_whatever_the_gripper_is_turned_by(example: SimpleNamespace, angle: float) -> None:
    x, y, theta, z = example.policy.action(np.array([3.0, -12.0]), angle, -7.0)
    turn = np.radians(angle)
    world = np.array([x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)])
    assert world / np.linalg.norm(world) == pytest.approx(np.array([3, -12]) / np.hypot(3, 12), abs=3e-3)
    assert max(abs(x), abs(y)) == 1.0
    assert (theta, z) == (-np.sign(angle), -1.0)


@pytest.mark.parametrize("hidden", [(Label.BASE,), (Label.PEG,), (Label.BASE, Label.PEG)])
def test_acts_where_a_picture_does_not_show_peg_or_base(example: SimpleNamespace, hidden: tuple[Label, ...]) -> None:
    given, labels = observation(CUBOID), seen(CUBOID)[2]
    dark = given | {"rgb_picture": np.where(np.isin(labels, hidden)[..., None], 30, given["rgb_picture"])}
    policy = begun(example)
    assert np.isfinite(policy.act(dark)).all()
    assert policy.place(np.zeros(4)).tolist() == example.policy.MIDDLE.tolist()
    policy.act(given)
    assert (len(policy.starts), policy.shape) == (1, "cuboid")


def test_a_place_where_no_episode_begins_is_no_estimate(
    example: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(example.policy, "fit_outline", lambda *_, rounds=0: np.array([30.0, 0.0]))
    policy = begun(example)
    policy.act(observation(CUBOID))
    assert policy.starts == []


def test_a_short_way_is_gone_whole(example: SimpleNamespace) -> None:
    action = example.policy.action(np.array([0.25, -0.5]), 0.0, 0.125)
    assert (action.dtype, action.tolist()) == (np.float32, [0.25, -0.5, 0.0, 0.125])


def travelled(example: SimpleNamespace, start: Any, to_go_mm: float, height_mm: float) -> tuple[Any, tuple[float, ...]]:
    """A policy that has looked at the start, and the motion that has brought it to a place before its hole."""
    policy = begun(example)
    policy.act(observation(start))
    x, y = example.solids.HOLES["hexagon" if start[4] else "cuboid"]
    here = true_place(start)
    side = np.sign(y - here[1])
    return policy, (x - here[0], y - side * to_go_mm - here[1], -here[2], height_mm - here[3])


@pytest.mark.parametrize("start", [CUBOID, HEXAGON])
def test_travels_at_the_hovering_height_and_goes_down_just_before_the_hole(
    example: SimpleNamespace, start: Any
) -> None:
    policy, motion = travelled(example, start, 5.0, 2.0)
    assert policy.act(observation(start, motion))[3] == pytest.approx(-1.0)
    policy, motion = travelled(example, start, 5.0, 0.6)
    assert abs(policy.act(observation(start, motion))[3]) < 0.4
    policy, motion = travelled(example, start, 1.2, 0.6)
    assert policy.act(observation(start, motion))[3] == -1.0


@pytest.mark.parametrize("start", [CUBOID, HEXAGON])
def test_touch_over_the_hole_lifts_and_goes_on_in_the_spiral_without_a_look(
    example: SimpleNamespace, start: Any
) -> None:
    policy, motion = travelled(example, start, 0.0, -0.4)
    before = len(policy.starts)
    action = policy.act(observation(start, motion, pressed=6.0))
    assert (policy.tries, policy.hover, len(policy.starts)) == (1, 0.6, before)
    assert action[3] > 0.7
    assert action[:2] == pytest.approx(example.policy.spiral(1), abs=0.6)


def test_touch_on_the_way_lifts_and_travels_higher(example: SimpleNamespace) -> None:
    start = CUBOID
    policy, motion = travelled(example, start, 8.0, -0.2)
    action = policy.act(observation(start, motion, pressed=6.0))
    assert (policy.tries, policy.hover) == (0, pytest.approx(1.1))
    assert action[3] == 1.0


def test_reset_forgets_the_episode_before(example: SimpleNamespace) -> None:
    used, fresh = begun(example), begun(example)
    used.act(observation(CUBOID, pressed=5.0))
    used.reset("fusion-insertion")
    assert used.act(observation(HEXAGON)).tobytes() == fresh.act(observation(HEXAGON)).tobytes()
