"""The picture of a team's own sensor: which markers are drawn where, not how it looks."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import drawn_gels
import matplotlib.pyplot as plt
import numpy as np
import own_sensors
import pytest
from matplotlib.axes import Axes
from vitac.envs.drawing import sensor_view as drawing
from vitac.envs.drawing.projection import ParallelCamera
from vitac.envs.drawing.sensor_view import draw_design
from vitac.envs.tactile.design import SensorDesign

SENSING_SIDE_DEG, BACK_DEG = 40.0, -40.0


@cache
def sensor() -> SensorDesign:
    """A ridge along y with markers on it and on the floor; from the eye at -60 degrees it hides some of them."""
    return own_sensors.design(drawn_gels.ridge(), "{points_mm: [[0, 5], [-1.9, 0], [-6, 0], [6, 0]]}")


@pytest.fixture
def axes() -> Iterator[Axes]:
    figure, made = plt.subplots()
    yield made
    plt.close(figure)


def markers(axes: Axes) -> np.ndarray:
    """Picture coordinates of the markers that are drawn, shape [n, 2]."""
    (drawn,) = (line for line in axes.get_lines() if line.get_marker() == "o")
    return np.asarray(drawn.get_xydata())


def test_markers_are_drawn_on_the_gel_where_they_are_printed(axes: Axes) -> None:
    drawing._draw_gel(axes, sensor(), SENSING_SIDE_DEG)
    camera = ParallelCamera(
        azimuth_deg=-60.0, elevation_deg=40.0, centre_m=(0.0, 0.0, 0.0), height_m=0.028, width_px=600, height_px=500
    )
    seen = camera.project(sensor().printed_m)[:, :2]
    # Seen from x > 0, the second one stands behind the ridge.
    np.testing.assert_allclose(markers(axes), seen[[0, 2, 3]])


def test_markers_of_the_sensing_face_are_not_seen_from_behind(axes: Axes) -> None:
    drawing._draw_gel(axes, sensor(), BACK_DEG)
    assert markers(axes).shape == (0, 2)
    assert len(axes.collections[0].get_paths()) > 20


def test_marker_off_the_gel_is_only_in_the_cameras_picture(axes: Axes) -> None:
    broken = replace(sensor(), markers_mm=np.array([[6.0, 0.0], [40.0, 0.0]]))
    drawing._draw_gel(axes, broken, SENSING_SIDE_DEG)
    assert len(markers(axes)) == 1
    drawing._draw_picture(axes, broken)
    (cross,) = (line for line in axes.get_lines() if line.get_marker() == "x")
    assert np.asarray(cross.get_xydata()).tolist() == [broken.rest_pixels[1].tolist()]


def test_picture_has_the_asked_width_and_three_times_less_height() -> None:
    picture = draw_design(sensor(), title="ridge", width_px=900)
    assert picture.shape == (300, 900, 3)
    assert picture.dtype == np.uint8
