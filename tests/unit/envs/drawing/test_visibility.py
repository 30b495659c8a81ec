import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from vitac.envs.drawing.projection import ParallelCamera
from vitac.envs.drawing.visibility import (
    NOTHING,
    Visible,
    averaged,
    lit,
    seen_through,
    sharp_edges,
    unique_edges,
    unit_normals,
    visible_lines,
)
from vitac.envs.geometry.pegs import PegShape, hole_surface, peg_surface
from vitac.envs.scene.perspective import Plane
from vitac.envs.tactile.gel import gelsight_mini_mesh

FloatArray = NDArray[np.float64]

# Seen from -y: x to the right, z upwards, one pixel per millimetre.
FRONT = ParallelCamera(
    azimuth_deg=-90.0, elevation_deg=0.0, centre_m=(0.0, 0.0, 0.0), height_m=0.03, width_px=40, height_px=30
)
SQUARE = np.array([[[5, 5, 0], [25, 5, 0], [25, 25, 0]], [[5, 5, 0], [25, 25, 0], [5, 25, 0]]], dtype=np.float64)


def at_depth(depth_m: float) -> FloatArray:
    return np.asarray(SQUARE + np.array([0.0, 0.0, depth_m]))


def test_a_triangulated_square_covers_every_pixel_once() -> None:
    visible = Visible.nothing(FRONT)
    visible.add(SQUARE, first=0)
    assert (visible.triangle[5:25, 5:25] != NOTHING).all()
    assert (visible.triangle != NOTHING).sum() == 400


def test_a_fan_of_slivers_leaves_no_pinhole() -> None:
    angle = np.linspace(0, 2 * np.pi, 98)
    rim = np.column_stack([20 + 12 * np.cos(angle), 15 + 12 * np.sin(angle), np.zeros(98)])
    fan = np.stack([np.broadcast_to([20.0, 15.0, 0.0], (97, 3)), rim[:-1], rim[1:]], axis=1)
    visible = Visible.nothing(FRONT)
    visible.add(fan, first=0)
    y, x = np.mgrid[0:30, 0:40] + 0.5
    assert (visible.triangle[np.hypot(x - 20, y - 15) < 11.9] != NOTHING).all()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_is_seen_whatever_comes_first(order: tuple[int, int]) -> None:
    layers = [(at_depth(0.002), 10), (at_depth(0.001), 20)]
    visible = Visible.nothing(FRONT)
    for index in order:
        triangles, first = layers[index]
        visible.add(triangles, first=first)
    assert set(np.unique(visible.triangle)) == {NOTHING, 20, 21}
    assert visible.depth_m[10, 10] == 0.001


def test_interpenetrating_triangles_are_parted_where_they_meet() -> None:
    tilted = SQUARE.copy()
    tilted[..., 2] = (tilted[..., 0] - 15.0) * 1e-4
    visible = Visible.nothing(FRONT)
    visible.add(SQUARE, first=0)
    visible.add(tilted, first=2)
    assert (visible.triangle[5:25, 5:15] >= 2).all()
    assert (visible.triangle[5:25, 15:25] < 2).all()


def test_what_is_outside_the_picture_is_left_out() -> None:
    visible = Visible.nothing(FRONT)
    visible.add(SQUARE + np.array([30.0, -20.0, 0.0]), first=0)
    assert (visible.triangle != NOTHING).sum() == 5 * 5
    visible.add(SQUARE + 100.0, first=2)
    assert visible.triangle.max() < 2


def test_the_part_that_is_cut_away_is_not_there() -> None:
    kept_m = 1e-3 * (15.0 - SQUARE[..., 0])
    visible = Visible.nothing(FRONT)
    visible.add(SQUARE, first=0, kept_m=kept_m)
    assert (visible.triangle[5:25, 5:15] != NOTHING).all()
    assert (visible.triangle[:, 15:] == NOTHING).all()


def test_a_closed_cut_hides_what_is_in_the_solid() -> None:
    visible = Visible.nothing(FRONT)
    visible.add(at_depth(0.010), first=0)
    plane = Plane(normal=(0.0, -1.0, 0.0), offset_m=-0.004)
    visible.close_cut(plane, FRONT, visible.triangle != NOTHING)
    assert visible.depth_m[10, 10] == pytest.approx(0.004)
    visible.add(at_depth(0.007), first=2)
    assert visible.triangle[10, 10] < 2


def test_values_are_linear_over_a_triangle() -> None:
    visible = Visible.nothing(FRONT)
    visible.add(SQUARE, first=0)
    here = visible.triangle != NOTHING
    values = 3.0 * SQUARE[..., 0] - 2.0 * SQUARE[..., 1] + 1.0
    y, x = np.mgrid[0:30, 0:40] + 0.5
    found = visible.interpolated(values, visible.triangle[here], here)
    assert found == pytest.approx((3.0 * x - 2.0 * y + 1.0)[here], abs=1e-4)


def test_hides_what_is_behind_and_what_is_outside() -> None:
    visible = Visible.nothing(FRONT)
    visible.add(at_depth(0.005), first=0)
    points = np.array([[10, 10, 0.004], [10, 10, 0.0052], [10, 10, 0.006], [35, 10, 9.0], [50, 10, 0.0], [10, -1, 0.0]])
    assert visible.hides(points, slack_m=5e-4).tolist() == [False, False, True, False, True, True]


def test_a_copy_does_not_change_the_original() -> None:
    visible = Visible.nothing(FRONT)
    visible.copy().add(SQUARE, first=0)
    assert (visible.triangle == NOTHING).all()


@pytest.mark.parametrize(("shape", "corners"), [(PegShape.CUBOID, 4), (PegShape.CONCAVE1, 8)])
def test_a_prism_has_the_edges_of_its_profile_and_no_diagonals(shape: PegShape, corners: int) -> None:
    peg, plate = peg_surface(shape), hole_surface(shape)
    assert len(sharp_edges(peg.vertices_m, peg.triangles)) == 3 * corners
    assert len(sharp_edges(plate.vertices_m, plate.triangles)) == 12 + 3 * corners


def test_a_gel_has_the_edges_of_a_bevelled_box() -> None:
    gel = gelsight_mini_mesh()
    ends_mm = 1e3 * gel.rest_position_m[sharp_edges(gel.rest_position_m, gel.surface_triangles)]
    assert np.abs(ends_mm[..., 2]).min() >= 1.0
    total_mm = np.linalg.norm(ends_mm[:, 1] - ends_mm[:, 0], axis=1).sum()
    slanted = 4 * np.sqrt(3**2 + 3**2 + 1)
    assert total_mm == pytest.approx(2 * 2 * (25.25 + 20.75) + 2 * (19.25 + 14.75) + 4 * 3 + slanted)


def test_every_edge_of_a_closed_surface_comes_once() -> None:
    triangles = gelsight_mini_mesh().surface_triangles
    edges = unique_edges(triangles)
    assert len(edges) == len({tuple(sorted(edge)) for edge in edges.tolist()}) == 3 * len(triangles) // 2


def test_normals_point_outwards() -> None:
    peg = peg_surface(PegShape.CUBOID)
    outwards = peg.vertices_m[peg.triangles].mean(axis=1) - peg.vertices_m.mean(axis=0)
    normals = unit_normals(peg.vertices_m, peg.triangles)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    assert ((normals * outwards).sum(axis=1) > 0).all()


def test_a_line_is_seen_on_both_sides_of_what_hides_its_middle() -> None:
    visible = Visible.nothing(FRONT)
    visible.add(
        np.array([[[15, 0, 0], [25, 0, 0], [25, 30, 0]], [[15, 0, 0], [25, 30, 0], [15, 30, 0]]], float), first=0
    )
    behind = np.array([[[-0.018, 0.01, 0.0], [0.018, 0.01, 0.0]]])
    before = behind - np.array([0.0, 0.02, 0.0])
    left, right = visible_lines(behind, FRONT, visible)
    assert left[0] == pytest.approx([2, 15])
    assert 13 <= left[-1, 0] < 15
    assert 25 <= right[0, 0] <= 27
    assert right[-1] == pytest.approx([38, 15])
    (whole,) = visible_lines(before, FRONT, visible)
    assert whole[[0, -1]] == pytest.approx(np.array([[2, 15], [38, 15]]))


def test_a_line_ends_where_it_is_cut_away() -> None:
    ends = np.array([[[-0.01, 0.0, 0.0], [0.01, 0.0, 0.0]]])
    (line,) = visible_lines(ends, FRONT, Visible.nothing(FRONT), kept_m=np.array([[0.01, -0.01]]))
    assert line[0] == pytest.approx([10, 15])
    assert 18 <= line[-1, 0] <= 20.1


TOWARDS_LIGHT = np.array([0.30, 0.78, -0.55])


def unit(x: float, y: float, z: float) -> np.ndarray:
    return np.asarray(np.array([[x, y, z]]) / np.linalg.norm([x, y, z]))


def test_a_face_towards_the_light_keeps_its_colour_and_one_away_from_it_is_darker() -> None:
    grey = np.array([0.8, 0.6, 0.4])
    assert lit(grey, unit(*TOWARDS_LIGHT)) == pytest.approx(grey[None], rel=0.01)
    assert lit(grey, unit(*-TOWARDS_LIGHT)) == pytest.approx(0.72 * grey[None])
    assert lit(grey, unit(*-TOWARDS_LIGHT), matt=False) == pytest.approx(0.88 * grey[None])


@given(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_light_never_leaves_the_range_of_colours_nor_changes_their_hue(normal: tuple[float, float, float]) -> None:
    colour = np.array([1.0, 0.5, 0.25])
    for matt in (True, False):
        found = lit(colour, unit(*normal), matt=matt)[0]
        assert 0.7 <= found[0] <= 1.0
        assert found / found[0] == pytest.approx(colour)


def test_each_face_may_have_its_own_colour() -> None:
    colours = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    normals = np.concatenate([unit(0.0, 0.0, 1.0), unit(*TOWARDS_LIGHT)])
    both = lit(colours, normals)
    for index in range(2):
        np.testing.assert_array_equal(both[index], lit(colours[index], normals[index : index + 1])[0])


def test_glass_is_mixed_in_only_where_it_is() -> None:
    glass, behind = np.ones((2, 3, 3)), np.zeros((2, 3, 3))
    is_glass = np.array([[True, False, False], [False, False, True]])
    mixed = seen_through(glass, behind, is_glass)
    assert mixed[is_glass] == pytest.approx(0.34)
    assert (mixed[~is_glass] == 0.0).all()
    assert (behind == 0.0).all(), "the picture behind is not changed"


def test_a_picture_seen_through_itself_is_itself() -> None:
    picture = np.random.default_rng(0).random((4, 5, 3))
    assert seen_through(picture, picture, np.ones((4, 5), dtype=bool)) == pytest.approx(picture)


@pytest.mark.parametrize("block", [1, 2, 3])
def test_blocks_are_averaged_and_the_mean_is_kept(block: int) -> None:
    picture = np.random.default_rng(block).random((6, 12, 3))
    small = averaged(picture, block)
    assert small.shape == (6 // block, 12 // block, 3)
    assert small.mean(axis=(0, 1)) == pytest.approx(picture.mean(axis=(0, 1)))
    assert small[0, -1] == pytest.approx(picture[:block, 12 - block :].mean(axis=(0, 1)))
