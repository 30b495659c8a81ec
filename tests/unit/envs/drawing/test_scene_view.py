"""The picture of a scene: everything is in it, gels have the colours of their values, and the peg is like glass."""

import matplotlib as mpl
import numpy as np
import pytest
from numpy.typing import NDArray
from vitac.envs.drawing.playback import Playback
from vitac.envs.drawing.scene_view import SceneImage, SceneView
from vitac.envs.tasks.peg_insertion.perspective import PERSPECTIVE

FloatArray = NDArray[np.float64]
WIDTH_PX, HEIGHT_PX = 240, 180
RED, BLUE = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)


def two_colours(values: FloatArray) -> FloatArray:
    return np.where(values[:, None] > 0.5, RED, BLUE)


def constant(playback: Playback, left: float, right: float) -> tuple[FloatArray, FloatArray]:
    nodes = len(playback.gel.rest_position_m)
    return np.full(nodes, left), np.full(nodes, right)


@pytest.fixture
def view(peg_playback: Playback) -> SceneView:
    return SceneView(peg_playback, PERSPECTIVE, width_px=WIDTH_PX, height_px=HEIGHT_PX)


@pytest.fixture
def image(view: SceneView, peg_playback: Playback) -> SceneImage:
    return view.image(peg_playback.moments[0], constant(peg_playback, 1.0, 0.0), two_colours)


def test_picture_has_the_size_asked_for_and_a_white_edge(image: SceneImage) -> None:
    assert image.rgb.shape == (HEIGHT_PX, WIDTH_PX, 3)
    assert (image.rgb >= 0.0).all()
    assert (image.rgb <= 1.0).all()
    assert (image.rgb[0] == 1.0).all()
    assert (image.rgb[-1] == 1.0).all()
    assert (image.rgb[:, 0] == 1.0).all()
    assert (image.rgb[:, -1] == 1.0).all()


def test_the_scene_fills_the_picture_in_one_direction(image: SceneImage) -> None:
    rows, columns = np.nonzero((image.rgb < 1.0).any(axis=2))
    assert max(np.ptp(rows) / HEIGHT_PX, np.ptp(columns) / WIDTH_PX) > 0.8


@pytest.mark.parametrize(("width_px", "height_px"), [(80, 240), (400, 120)])
def test_the_scene_fits_narrow_and_flat_pictures(peg_playback: Playback, width_px: int, height_px: int) -> None:
    narrow = SceneView(peg_playback, PERSPECTIVE, width_px=width_px, height_px=height_px)
    rgb = narrow.image(peg_playback.moments[0], constant(peg_playback, 1.0, 0.0), two_colours).rgb
    rows, columns = np.nonzero((rgb < 1.0).any(axis=2))
    assert 0 < rows.min() < rows.max() < height_px - 1
    assert 0 < columns.min() < columns.max() < width_px - 1
    assert max(np.ptp(rows) / height_px, np.ptp(columns) / width_px) > 0.75


def test_every_line_lies_within_the_picture(view: SceneView, peg_playback: Playback) -> None:
    for moment in peg_playback.moments:
        image = view.image(moment, constant(peg_playback, 0.0, 0.0), two_colours)
        lines = [*image.lines, *image.faint_lines, *image.element_lines, *image.cut_lines]
        assert len(lines) > 100
        points = np.concatenate(lines)
        assert (points >= 0.0).all()
        assert (points <= [WIDTH_PX, HEIGHT_PX]).all()


def test_each_gel_has_the_colour_of_its_own_values(image: SceneImage) -> None:
    is_red = (image.rgb[:, :, 0] > 0.6) & (image.rgb[:, :, 2] < 0.05)
    is_blue = (image.rgb[:, :, 2] > 0.6) & (image.rgb[:, :, 0] < 0.05)
    for where, (low, high) in zip((is_red, is_blue), image.gel_boxes, strict=True):
        rows, columns = np.nonzero(where)
        assert len(rows) > 50
        assert (np.floor(low) <= [columns.min(), rows.min()]).all()
        assert (np.ceil(high) >= [columns.max(), rows.max()]).all()


def test_a_value_at_some_nodes_colours_that_part_of_the_gel(view: SceneView, peg_playback: Playback) -> None:
    along = peg_playback.gel.rest_position_m[:, 0]
    half = np.where(along > 0.0, 1.0, 0.0)
    image = view.image(peg_playback.moments[0], (half, half), two_colours)
    is_red = (image.rgb[:, :, 0] > 0.6) & (image.rgb[:, :, 2] < 0.05)
    is_blue = (image.rgb[:, :, 2] > 0.6) & (image.rgb[:, :, 0] < 0.05)
    assert min(is_red.sum(), is_blue.sum()) > 50
    # The gels' x points down in the world.
    assert np.nonzero(is_red)[0].mean() > np.nonzero(is_blue)[0].mean() + 5


def test_values_change_colours_and_nothing_else(view: SceneView, peg_playback: Playback, image: SceneImage) -> None:
    swapped = view.image(peg_playback.moments[0], constant(peg_playback, 0.0, 1.0), two_colours)
    np.testing.assert_allclose(swapped.rgb[:, :, 1], image.rgb[:, :, 1], atol=1e-12)
    assert (swapped.rgb != image.rgb).any()
    np.testing.assert_array_equal(swapped.gel_boxes, image.gel_boxes)
    assert [line.tolist() for line in swapped.lines] == [line.tolist() for line in image.lines]


def test_a_moment_looks_the_same_whatever_was_drawn_before(view: SceneView, peg_playback: Playback) -> None:
    values, colours = constant(peg_playback, 0.3, 0.8), mpl.colormaps["viridis"]
    first = view.image(peg_playback.moments[0], values, colours).rgb
    other = view.image(peg_playback.moments[-1], values, colours).rgb
    assert (other != first).any()
    np.testing.assert_array_equal(view.image(peg_playback.moments[0], values, colours).rgb, first)


def test_the_held_part_is_drawn_where_it_goes(view: SceneView, peg_playback: Playback) -> None:
    first, last = peg_playback.moments[0], peg_playback.moments[-1]
    values = constant(peg_playback, 0.0, 0.0)
    start, end = (view.image(moment, values, two_colours).held_middle for moment in (first, last))
    assert last.held_m[:, 2].mean() < first.held_m[:, 2].mean()
    assert end[1] > start[1], "the peg goes down, and so does its place in the picture"


def test_the_lowest_place_of_the_fixed_part_is_below_all_else(image: SceneImage) -> None:
    rows, _ = np.nonzero((image.rgb < 1.0).any(axis=2))
    assert image.fixed_bottom[1] == pytest.approx(rows.max(), abs=1.0)
    assert image.fixed_bottom[1] > image.gel_boxes[:, 1, 1].max()
