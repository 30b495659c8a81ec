"""Tactile pictures: an untouched gel looks like its background, a body shows its outline, dots lie on the markers."""

import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.tactile.camera import camera_frame
from vitac.envs.tactile.gel import gelsight_mini_mesh
from vitac.envs.vision.tactile_picture import TactileCamera, TactilePicture

GEL = gelsight_mini_mesh()
CAMERA = TactileCamera(GEL)
AT_REST_M = camera_frame(GEL.rest_position_m, np.eye(3), np.zeros(3), 0.02)
NO_BODY = (np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
NO_MARKERS = np.zeros((0, 2))
BLUE, GREEN, RED = 0, 1, 2


def plate(depth_m: float, half_m: float = 0.004) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Square across the camera's axis, 62 pixels each way from the picture's centre."""
    corners = [(-half_m, -half_m, depth_m), (half_m, -half_m, depth_m)]
    corners += [(half_m, half_m, depth_m), (-half_m, half_m, depth_m)]
    return np.array(corners), np.array([[0, 2, 1], [0, 3, 2]])


def taken(depth_m: float | None = None, markers_px: NDArray[np.float64] = NO_MARKERS) -> TactilePicture:
    body = NO_BODY if depth_m is None else plate(depth_m)
    return CAMERA.picture(AT_REST_M, *body, markers_px)


def change(depth_m: float) -> NDArray[np.int64]:
    return taken(depth_m).astype(np.int64) - taken()


def test_an_untouched_gel_has_the_colours_of_the_facts() -> None:
    """The challenge's picture, red, green, blue at rows 10, 120 and 230."""
    picture = taken()
    assert picture.shape == (240, 320, 3)
    assert picture[10, 10].tolist() == [65, 74, 39]
    assert picture[120, 160].tolist() == [176, 137, 117]
    assert picture[230, 310].tolist() == [88, 96, 24]


def test_a_body_behind_the_gel_is_not_seen() -> None:
    np.testing.assert_array_equal(taken(0.0225), taken())


def test_each_flank_of_a_bump_is_lit_by_the_light_on_its_side() -> None:
    """Green shines from the right, red from above, blue from below; the plate's edges lie at columns 97 and 223."""
    changed = change(0.0216)
    right, left = changed[125, 220:230].mean(axis=0), changed[125, 92:100].mean(axis=0)
    above, below = changed[62:68, 160].mean(axis=0), changed[183:189, 160].mean(axis=0)
    assert right.argmax() == GREEN
    assert right[GREEN] > 20
    assert left[GREEN] < -5
    assert above.argmax() == RED
    assert above[RED] > 20
    assert below.argmax() == BLUE
    assert below[BLUE] > 20


def test_a_flat_face_that_is_pressed_in_is_as_bright_as_before() -> None:
    assert np.abs(change(0.0216)[100:150, 120:200]).max() <= 1


def test_a_deeper_body_shows_more() -> None:
    assert np.abs(change(0.0213)).sum() > 1.5 * np.abs(change(0.0218)).sum() > 0


def test_the_gels_own_deformation_shows_without_a_body() -> None:
    pressed_m = AT_REST_M.copy()
    sensing = np.flatnonzero(GEL.sensing)
    middle = sensing[np.hypot(*AT_REST_M[sensing, :2].T) < 0.003]
    pressed_m[middle, 2] -= 0.0005
    pressed = CAMERA.picture(pressed_m, *NO_BODY, NO_MARKERS).astype(np.int64)
    assert np.abs(pressed - taken()).max() > 20


def test_dots_are_black_discs_of_three_pixels_on_the_markers() -> None:
    picture = taken(markers_px=np.array([[100.5, 60.5], [200.0, 150.0]]))
    assert picture[60, 100].max() == 0
    assert picture[149:151, 199:201].max() == 0
    share = picture[50:72, 90:112].astype(float) / np.maximum(taken()[50:72, 90:112], 1)
    covered_px = (1.0 - share).mean(axis=2).sum()
    assert covered_px == pytest.approx(np.pi * 3.0**2, rel=0.05)
    np.testing.assert_array_equal(picture[:, 240:], taken()[:, 240:])


@pytest.mark.parametrize("marker", [(0.0, 0.0), (319.9, 239.9), (-3.0, 100.0), (500.0, 900.0), (-40.0, -2.0)])
def test_markers_at_and_beyond_the_edge_are_drawn_as_far_as_they_are_in_the_picture(
    marker: tuple[float, float],
) -> None:
    picture = taken(markers_px=np.array([marker]))
    darker = np.argwhere((picture != taken()).any(axis=2))
    assert all(abs(column + 0.5 - marker[0]) < 6 and abs(row + 0.5 - marker[1]) < 6 for row, column in darker)


def test_a_marker_that_is_repeated_is_one_dot() -> None:
    once, often = np.array([[100.2, 60.7]]), np.tile([100.2, 60.7], (128, 1))
    np.testing.assert_array_equal(taken(markers_px=once), taken(markers_px=often))


def test_noise_has_its_spread_and_changes_with_its_key_only() -> None:
    noisy = [CAMERA.picture(AT_REST_M, *NO_BODY, NO_MARKERS, key) for key in (7, 7, 8)]
    np.testing.assert_array_equal(noisy[0], noisy[1])
    assert (noisy[0] != noisy[2]).mean() > 0.5
    difference = noisy[0].astype(np.int64) - noisy[2]
    assert difference.std() / 2**0.5 == pytest.approx(1.0, rel=0.1)
    assert abs(difference.mean()) < 0.02
