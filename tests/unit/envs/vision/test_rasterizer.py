"""The rasteriser sees what a ray caster over all triangles sees, to the last nanometre."""

import numpy as np
import pytest
from ray_caster import cast, pixel_centres
from visible_scenes import STARTS, SeenScene, fusion_scene, random_scene
from vitac.envs.vision.optics import COLOUR_INTRINSICS, HEIGHT_PX, WIDTH_PX, Intrinsics
from vitac.envs.vision.pinhole import CameraPose
from vitac.envs.vision.rasterizer import NEAR_M, NO_TRIANGLE, Body, Label, VerticesDoNotFit, VisibleSurfaces, rasterize

SMALL = Intrinsics(70.0, 65.0, 33.3, 22.8)
SMALL_HEIGHT_PX, SMALL_WIDTH_PX = 48, 64
# A pixel lies on an edge where rays this far beside its own meet another body.
EDGE_PX = 1e-6


def bodies(triangle: np.ndarray) -> np.ndarray:
    """Index of the box that each triangle belongs to, -1 for none; a box has twelve triangles."""
    return np.where(triangle == NO_TRIANGLE, -1, triangle // 12)


def on_edge(scene: SeenScene, pixels: np.ndarray) -> np.ndarray:
    """Whether rays close beside those of pixels meet different triangles."""
    around = [
        cast(scene.vertices_m, scene.surfaces.triangles, scene.pose, SMALL, pixels + np.array(shift), NEAR_M).triangle
        for shift in ((EDGE_PX, EDGE_PX), (-EDGE_PX, EDGE_PX), (EDGE_PX, -EDGE_PX), (-EDGE_PX, -EDGE_PX))
    ]
    return np.asarray(np.any([triangle != around[0] for triangle in around[1:]], axis=0))


@pytest.mark.slow
def test_depth_and_body_are_those_of_a_ray_caster_in_100_random_scenes() -> None:
    random = np.random.default_rng(10)
    pixels = pixel_centres(SMALL_HEIGHT_PX, SMALL_WIDTH_PX)
    seen = differing = 0
    for _ in range(100):
        scene = random_scene(random, bodies=8)
        view = scene.view(SMALL, height_px=SMALL_HEIGHT_PX, width_px=SMALL_WIDTH_PX)
        hits = cast(scene.vertices_m, scene.surfaces.triangles, scene.pose, SMALL, pixels, NEAR_M)
        same = bodies(view.triangle.ravel()) == bodies(hits.triangle)
        assert np.abs(view.depth_m.ravel() - hits.depth_m)[same].max() < 1e-9
        assert on_edge(scene, pixels[~same]).all()
        seen += int((hits.triangle != NO_TRIANGLE).sum())
        differing += int((~same).sum())
    assert seen > 50_000
    assert differing < 1e-3 * seen


def test_depth_of_the_task_is_that_of_a_ray_caster() -> None:
    scene = fusion_scene(STARTS[0])
    view = scene.view()
    rows, columns = (axis[::37] for axis in np.nonzero(view.triangle != NO_TRIANGLE))
    pixels = np.column_stack([columns + 0.5, rows + 0.5])
    hits = cast(scene.vertices_m, scene.surfaces.triangles, scene.pose, COLOUR_INTRINSICS, pixels, NEAR_M)
    assert len(pixels) > 300
    assert np.abs(view.depth_m[rows, columns] - hits.depth_m).max() < 1e-9


def test_a_pixel_is_the_ray_through_its_centre() -> None:
    """A plane whose depth is a function of the ray: z = 1 / (1 - 0.3 x - 0.2 y)."""
    corners = ((-3.0, -3.0), (3.0, -3.0), (-3.0, 3.0))
    vertices = np.array([np.array([u, v, 1.0]) / (1.0 - 0.3 * u - 0.2 * v) for u, v in corners])
    triangles = np.array([[0, 1, 2]])
    view = rasterize(vertices, triangles, SMALL, height_px=SMALL_HEIGHT_PX, width_px=SMALL_WIDTH_PX)
    rows, columns = np.nonzero(view.triangle == 0)
    x, y = (columns + 0.5 - 33.3) / 70.0, (rows + 0.5 - 22.8) / 65.0
    assert len(rows) > 1000
    assert view.depth_m[rows, columns] == pytest.approx(1.0 / (1.0 - 0.3 * x - 0.2 * y), abs=1e-12)


def test_what_is_nearer_than_the_near_plane_is_cut_away() -> None:
    """Through the cut, the inside of the far wall is seen."""
    tilted = np.array([[-0.02, -0.02, 0.05], [0.02, -0.02, 0.05], [0.0, 0.04, 0.2]])
    view = rasterize(tilted, np.array([[0, 1, 2]]), SMALL, height_px=SMALL_HEIGHT_PX, width_px=SMALL_WIDTH_PX)
    seen = view.depth_m[view.triangle == 0]
    assert len(seen) > 0
    assert seen.min() >= NEAR_M
    behind = tilted - [0.0, 0.0, 1.0]
    assert (rasterize(behind, np.array([[0, 1, 2]]), SMALL, height_px=9, width_px=9).triangle == NO_TRIANGLE).all()


def test_no_ray_slips_through_between_two_triangles() -> None:
    """A fan of slivers around the optical axis covers its disc without a hole."""
    random = np.random.default_rng(3)
    angles = np.sort(random.uniform(0.0, 2.0 * np.pi, 60))
    rim = np.column_stack([0.3 * np.cos(angles), 0.3 * np.sin(angles), np.full(60, 0.4)])
    vertices = np.concatenate([[[0.01, -0.02, 0.3]], rim])
    triangles = np.array([[0, 1 + i, 1 + (i + 1) % 60] for i in range(60)])
    view = rasterize(vertices, triangles, Intrinsics(300.0, 300.0, 150.0, 150.0), height_px=300, width_px=300)
    rows, columns = np.mgrid[:300, :300]
    inside = np.hypot(columns - 149.5, rows - 149.5) < 200
    assert (view.triangle[inside] != NO_TRIANGLE).all()


def test_a_plane_through_the_optical_centre_is_not_seen() -> None:
    edge_on = np.array([[-0.1, 0.0, 0.3], [0.1, 0.0, 0.3], [0.0, 0.0, 0.5]])
    centred = Intrinsics(60.0, 60.0, 30.5, 30.5)
    view = rasterize(edge_on, np.array([[0, 1, 2]]), centred, height_px=61, width_px=61)
    assert (view.triangle == NO_TRIANGLE).all()


def test_of_two_triangles_at_one_depth_the_first_is_seen() -> None:
    wall = np.array([[-1.0, -1.0, 0.5], [1.0, -1.0, 0.5], [0.0, 1.0, 0.5]])
    view = rasterize(wall, np.array([[0, 2, 1], [0, 1, 2]]), SMALL, height_px=9, width_px=9)
    assert set(view.triangle.ravel().tolist()) <= {0, NO_TRIANGLE}


def test_box_holds_all_that_is_seen_and_nothing_more() -> None:
    view = fusion_scene(STARTS[0]).view()
    rows, columns = np.nonzero(view.triangle != NO_TRIANGLE)
    assert view.box == (slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1))


def test_box_of_an_empty_view_is_empty() -> None:
    view = rasterize(np.zeros((3, 3)), np.array([[0, 1, 2]]), SMALL, height_px=9, width_px=9)
    assert view.triangle[view.box].size == 0
    assert (view.depth_m == 0.0).all()


@pytest.mark.parametrize("start", STARTS)
def test_the_task_is_seen_at_the_stated_depths_and_places(start: tuple[float, float, float, float, int]) -> None:
    """The challenge's picture: 0.396 to 0.523 m, inside a box of about 126 x 139 pixels; ours is two pixels larger."""
    view = fusion_scene(start).view()
    rows, columns = view.box
    assert columns.stop - columns.start <= 128
    assert rows.stop - rows.start <= 141
    depth_m = view.depth_m[view.triangle != NO_TRIANGLE]
    assert depth_m.min() > 0.395
    assert depth_m.max() < 0.524


def test_a_camera_between_two_bodies_sees_only_the_one_before_it() -> None:
    wall = np.array([[-1.0, -1.0, 0.5], [1.0, -1.0, 0.5], [0.0, 1.0, 0.5]])
    pose = CameraPose(world_from_camera=np.eye(3), position_m=np.zeros(3))
    vertices = pose.transform_to_camera(np.concatenate([wall, -wall]))
    view = rasterize(vertices, np.array([[0, 1, 2], [3, 4, 5]]), SMALL, height_px=HEIGHT_PX, width_px=WIDTH_PX)
    assert set(view.triangle.ravel().tolist()) == {0, NO_TRIANGLE}


TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]])


def two_bodies() -> VisibleSurfaces:
    return VisibleSurfaces(
        [
            Body(vertex_count=4, triangles=TRIANGLES, label=Label.PEG),
            Body(vertex_count=5, triangles=TRIANGLES[:1], label=Label.LEFT_GEL),
        ]
    )


def test_triangles_count_through_the_bodies_vertices() -> None:
    assert two_bodies().triangles.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    assert two_bodies().labels.tolist() == [Label.PEG, Label.PEG, Label.LEFT_GEL]


def test_vertices_stand_in_the_order_of_the_bodies() -> None:
    first, second = np.zeros((4, 3)), np.ones((5, 3))
    assert two_bodies().vertices_m([first, second])[:, 0].tolist() == [0.0] * 4 + [1.0] * 5


@pytest.mark.parametrize("counts", [(4,), (4, 4), (5, 4), (4, 5, 4)])
def test_refuses_vertices_of_other_bodies(counts: tuple[int, ...]) -> None:
    with pytest.raises(VerticesDoNotFit, match=r"expected \[\(4, 3\), \(5, 3\)\]"):
        two_bodies().vertices_m([np.zeros((count, 3)) for count in counts])
