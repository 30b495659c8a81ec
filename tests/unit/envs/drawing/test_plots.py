"""The two small plots: what stands where in them, not how it looks."""

from collections.abc import Iterator
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from vitac.envs.drawing.playback import EpisodePlayback
from vitac.envs.drawing.plots import draw_progress, draw_section
from vitac.envs.geometry.pegs import PROFILES_MM, PegShape
from vitac.envs.scene.perspective import Plane
from vitac.envs.tasks.peg_insertion.definition import PERSPECTIVE


@pytest.fixture
def axes() -> Iterator[Axes]:
    figure, made = plt.subplots()
    yield made
    plt.close(figure)


def test_section_shows_the_hole_and_the_peg_at_its_offset(axes: Axes, peg_playback: EpisodePlayback) -> None:
    draw_section(axes, PERSPECTIVE, peg_playback, peg_playback.moments[0])
    plate, peg = axes.patches
    assert plate.get_path().get_extents().bounds == pytest.approx((-35.0, -25.0, 70.0, 50.0))
    x_mm, y_mm, theta_deg = peg_playback.moments[0].info["gt_offset_mm_deg"]
    sine, cosine = np.sin(np.radians(theta_deg)), np.cos(np.radians(theta_deg))
    profile_mm = PROFILES_MM[PegShape.TRAPEZOID] @ np.array([[cosine, sine], [-sine, cosine]]) + [x_mm, y_mm]
    extents_mm = peg.get_path().get_extents().get_points()
    assert extents_mm == pytest.approx(np.array([profile_mm.min(axis=0), profile_mm.max(axis=0)]), abs=1e-6)
    assert (axes.get_xlim(), axes.get_ylim()) == PERSPECTIVE.section.limits_mm
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title()) == ("x [mm]", "y [mm]", "hole and peg from above")


def test_section_shows_the_peg_dashed_where_the_policy_believes_it(axes: Axes, peg_playback: EpisodePlayback) -> None:
    moment = peg_playback.moments[-1]
    draw_section(axes, PERSPECTIVE, peg_playback, replace(moment, belief_error=np.array([2.0, -1.0, 180.0])))
    _, peg, believed = axes.patches
    assert (peg.get_linestyle(), believed.get_linestyle(), believed.get_fill()) == ("solid", (0, (3, 2)), False)
    middle_mm = 1e3 * moment.held_m[:, :2].mean(axis=0)
    low, high = (2.0 * middle_mm - corner for corner in peg.get_path().get_extents().get_points()[::-1])
    found = believed.get_path().get_extents().get_points()
    assert found == pytest.approx(np.add([low, high], [2.0, -1.0]), abs=0.05)


def test_section_beyond_a_part_shows_nothing_of_it(axes: Axes, peg_playback: EpisodePlayback) -> None:
    above = replace(PERSPECTIVE.section, fixed_cut=Plane(normal=(0.0, 0.0, 1.0), offset_m=1.0))
    draw_section(axes, replace(PERSPECTIVE, section=above), peg_playback, peg_playback.moments[0])
    plate, peg = axes.patches
    assert np.size(plate.get_path().vertices) == 0
    assert np.size(peg.get_path().vertices) > 8


@pytest.mark.parametrize("index", [0, 1, -1])
def test_progress_is_drawn_up_to_the_present_moment(axes: Axes, peg_playback: EpisodePlayback, index: int) -> None:
    moments = peg_playback.moments
    draw_progress(axes, PERSPECTIVE.progress, peg_playback, range(len(moments))[index])
    corners = [line for line in axes.get_lines() if line.get_marker() == "o"]
    shown = moments[: range(len(moments))[index] + 1]
    assert len(corners) == len(moments[0].info["peg_relative_z_mm"])
    for corner, line in enumerate(corners):
        assert np.asarray(line.get_xdata()).tolist() == [moment.env_step for moment in shown]
        assert np.asarray(line.get_ydata()).tolist() == [moment.info["peg_relative_z_mm"][corner] for moment in shown]


def test_progress_has_the_same_limits_at_every_moment_and_holds_the_goal(
    axes: Axes, peg_playback: EpisodePlayback
) -> None:
    progress = PERSPECTIVE.progress
    draw_progress(axes, progress, peg_playback, 0)
    first = axes.get_ylim()
    axes.clear()
    draw_progress(axes, progress, peg_playback, len(peg_playback.moments) - 1)
    assert axes.get_ylim() == first
    assert first[0] < progress.goal_mm < first[1]
    (label,) = axes.texts
    assert (label.get_text(), label.get_verticalalignment()) == ("success", "bottom")


def test_goal_above_has_its_label_at_the_top(axes: Axes, peg_playback: EpisodePlayback) -> None:
    upwards = replace(PERSPECTIVE.progress, goal_is_below=False, goal_mm=5.0)
    draw_progress(axes, upwards, peg_playback, 0)
    (label,) = axes.texts
    assert label.get_verticalalignment() == "top"
    assert axes.get_ylim()[1] > 5.0
