"""Infrared pictures: dots that lie still on the surfaces, shadows of the projector, noise of the stated size."""

import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.vision.look import unit_normals
from vitac.envs.vision.optics import Intrinsics
from vitac.envs.vision.rasterizer import rasterize
from vitac.envs.vision.stereo.infrared import (
    ALBEDO,
    AMBIENT,
    HALF_WIDTH,
    SPECKLE_SD,
    TEXELS,
    THERMAL_SD_GREY,
    InfraredView,
    Projector,
    dot_pattern,
    infrared_picture,
)

OPTICS = Intrinsics(600.0, 600.0, 100.0, 75.0)
HEIGHT_PX, WIDTH_PX = 150, 200
KEY = np.uint64(20260731)
FULL_LIGHT = np.full((4, 4), 255, dtype=np.uint8)
NO_LIGHT = np.zeros((4, 4), dtype=np.uint8)


def wall(z_m: float, left_m: float = -0.5, right_m: float = 0.5) -> NDArray[np.float64]:
    """Corners of a rectangle across the optical axis, shape [4, 3] [m]."""
    return np.array([[left_m, -0.5, z_m], [right_m, -0.5, z_m], [right_m, 0.5, z_m], [left_m, 0.5, z_m]])


RECTANGLE = np.array([[0, 2, 1], [0, 3, 2]])


def picture(
    vertices: NDArray[np.float64], x_m: float, *, pattern: NDArray[np.uint8] | None = None, key: np.uint64 = KEY
) -> NDArray[np.uint8]:
    """What an infrared camera on the projector's right sees of rectangles."""
    triangles = np.concatenate([RECTANGLE + 4 * i for i in range(len(vertices) // 4)])
    lit = rasterize(vertices, triangles, OPTICS, height_px=HEIGHT_PX, width_px=WIDTH_PX)
    seen = rasterize(vertices - [x_m, 0, 0], triangles, OPTICS, height_px=HEIGHT_PX, width_px=WIDTH_PX)
    projector = Projector(dot_pattern() if pattern is None else pattern, lit.depth_m, lit.triangle, OPTICS)
    view = InfraredView(seen.depth_m, seen.triangle, OPTICS, x_m)
    return infrared_picture(view, projector, unit_normals(vertices, triangles), key)


def test_a_surface_point_is_as_bright_in_both_pictures() -> None:
    """At 0.5 m, 60 mm of distance between the cameras is 72 px."""
    left, right = picture(wall(0.5), 0.0), picture(wall(0.5), 0.06)
    bright = left[:, 72:] > 30
    assert bright.sum() > 500
    difference = left[:, 72:].astype(int) - right[:, :-72]
    # Both pictures have noise of 2.7 % and 0.25 grey levels.
    assert np.abs(difference[bright]).mean() < 4
    assert np.corrcoef(left[:, 72:].ravel(), right[:, :-72].ravel())[0, 1] > 0.98


def test_a_body_shades_the_wall_behind_it_from_the_projector() -> None:
    """The camera beside the projector sees the wall behind the body's edge, where no dot falls."""
    bodies = np.concatenate([wall(1.0), wall(0.5, left_m=-0.5, right_m=0.0)])
    seen = picture(bodies, 0.03, pattern=FULL_LIGHT)
    # The body ends at x = 0, so its shadow on the wall too; it ends at column 64 in the picture, the shadow at 82.
    body, shadow, lit_wall = seen[70:80, 20:60], seen[70:80, 67:79], seen[70:80, 90:180]
    assert body.min() > 100
    assert lit_wall.min() > 100
    assert shadow.max() < 255 * ALBEDO * AMBIENT * 2


def test_the_background_is_dark() -> None:
    seen = picture(wall(0.5, left_m=-0.01, right_m=0.01), 0.0, pattern=FULL_LIGHT)
    assert (seen[:, :80] == 0).all()
    assert (seen[:, 120:] == 0).all()
    assert (seen[:, 95:105] > 100).all()


def test_what_no_dot_reaches_still_has_even_light() -> None:
    seen = picture(wall(0.5), 0.0, pattern=NO_LIGHT)
    assert seen.min() >= 1
    assert seen.mean() == pytest.approx(255 * ALBEDO * AMBIENT - 0.5, abs=0.2)


def test_slanted_surfaces_are_darker() -> None:
    """At 60 degrees of incidence, half of the light."""
    low, high = 0.4, 0.4 + 0.02 * 3**0.5
    slanted = np.array([[-0.05, -0.01, low], [0.05, -0.01, low], [0.05, 0.01, high], [-0.05, 0.01, high]])
    straight = picture(wall(0.41), 0.0, pattern=FULL_LIGHT)[75, 100]
    assert picture(slanted, 0.0, pattern=FULL_LIGHT)[75, 95:105].mean() == pytest.approx(straight / 2, rel=0.06)


def test_noise_has_the_stated_width_and_comes_from_its_key() -> None:
    seen = picture(wall(0.5), 0.0, pattern=FULL_LIGHT).astype(float)
    middle = seen[50:100, 75:125]
    brightness = 255 * ALBEDO * (1 + AMBIENT)
    # Truncation to whole grey levels adds a uniform error.
    expected = np.sqrt((brightness * SPECKLE_SD) ** 2 + THERMAL_SD_GREY**2 + 1 / 12)
    assert middle.std() == pytest.approx(expected, rel=0.05)
    assert middle.mean() == pytest.approx(brightness - 0.5, abs=0.3)
    again = picture(wall(0.5), 0.0, pattern=FULL_LIGHT)
    other = picture(wall(0.5), 0.0, pattern=FULL_LIGHT, key=np.uint64(7))
    np.testing.assert_array_equal(again, seen)
    assert abs(np.corrcoef(other.ravel(), again.ravel())[0, 1]) < 0.05


def test_neighbouring_pixels_have_independent_noise() -> None:
    middle = picture(wall(0.5), 0.0, pattern=FULL_LIGHT)[50:100, 75:125].astype(float)
    for a, b in ((middle[:, :-1], middle[:, 1:]), (middle[:-1], middle[1:])):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.06


# Two texels are about one pixel of the infrared cameras, whose focal length is 596 px.
TEXELS_PER_BLOCK = 14


def test_pattern_covers_more_than_the_colour_cameras_picture() -> None:
    assert dot_pattern().shape == (TEXELS, TEXELS)
    assert HALF_WIDTH > 320 / 604.3075


def test_every_block_of_the_matcher_holds_light_and_dark() -> None:
    pattern = dot_pattern()[: TEXELS // TEXELS_PER_BLOCK * TEXELS_PER_BLOCK, : TEXELS // TEXELS_PER_BLOCK * 14]
    blocks = pattern.reshape(TEXELS // TEXELS_PER_BLOCK, TEXELS_PER_BLOCK, -1, TEXELS_PER_BLOCK)
    assert (blocks.max(axis=(1, 3)) > 60).mean() > 0.99
    assert (blocks.min(axis=(1, 3)) == 0).all()


def test_rows_do_not_repeat_within_the_matchers_window() -> None:
    """A pattern that looked like itself 1 to 95 pixels further would be matched there."""
    rows = dot_pattern()[400:414].astype(np.float64) - dot_pattern()[400:414].mean()
    energy = float((rows * rows).sum())
    shifted = [float((rows[:, :-shift] * rows[:, shift:]).sum()) / energy for shift in range(8, 190)]
    assert max(shifted) < 0.4
