import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.drawing.projection.camera import ParallelCamera
from vitac.envs.drawing.projection.visibility import NOTHING, Visible
from vitac.envs.scene.perspective import Plane

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
