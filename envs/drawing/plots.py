"""The two small plots of a picture: a section through both parts, and the heights by which success is judged."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ..scene.perspective import Perspective, Plane, ProgressPlot, SectionView
from .playback import EpisodePlayback, Moment
from .projection import section_loops_m
from .visibility import CUT_COLOUR, HELD_COLOUR

FloatArray = NDArray[np.float64]

INK, QUIET = "#22262b", "#5c6670"
GOAL_COLOUR, BELIEF_COLOUR = "#1b7837", "#a3217a"
TITLE_PT, TICK_PT = 9.0, 8.0


def draw_section(axes: Axes, perspective: Perspective, playback: EpisodePlayback, moment: Moment) -> None:
    """Draw both parts, cut, in their places, and dashed the held one where the policy believes it."""
    view = perspective.section
    fixed = _outline(playback.fixed_m, playback.fixed.triangles, view.fixed_cut, view)
    held = _outline(moment.held_m, playback.held.triangles, view.held_cut, view)
    axes.add_patch(PathPatch(fixed, facecolor=CUT_COLOUR, edgecolor=INK, linewidth=0.7))
    axes.add_patch(PathPatch(held, facecolor=(*HELD_COLOUR, 0.85), edgecolor=INK, linewidth=0.9))
    if moment.belief_error is not None:
        believed = _outline(_moved(moment.held_m, moment.belief_error), playback.held.triangles, view.held_cut, view)
        axes.add_patch(PathPatch(believed, fill=False, edgecolor=BELIEF_COLOUR, linewidth=1.1, linestyle=(0, (3, 2))))
    axes.set(xlim=view.limits_mm[0], ylim=view.limits_mm[1], aspect="equal")
    (_, across), (_, upwards) = view.axes
    axes.set_xlabel(f"{across} [mm]", size=TICK_PT, color=INK, labelpad=1)
    axes.set_ylabel(f"{upwards} [mm]", size=TICK_PT, color=INK, labelpad=1)
    style(axes, view.title)


def draw_progress(axes: Axes, progress: ProgressPlot, playback: EpisodePlayback, index: int) -> None:
    """Draw the heights that decide, over the env steps of the episode up to the present moment."""
    ends = [playback.moments[last] for last in playback.last_moments]
    steps = np.array([moment.env_step for moment in ends])
    heights = np.array([progress.heights_mm(moment.info) for moment in ends])
    shown = np.array(playback.last_moments) <= index
    axes.axhline(0.0, color=QUIET, linewidth=0.6)
    axes.plot(steps[shown], heights[shown], color="#3b6ea5", linewidth=1.1, marker="o", markersize=3)
    low, high = _limits(heights, progress)
    axes.set(xlim=(-0.3, max(int(steps[-1]), 1) + 0.3), ylim=(low, high))
    beyond = low if progress.goal_is_below else high
    axes.axhspan(progress.goal_mm, beyond, color=GOAL_COLOUR, alpha=0.13, linewidth=0)
    axes.text(
        0.97,
        0.03 if progress.goal_is_below else 0.97,
        "success",
        size=TICK_PT,
        color=GOAL_COLOUR,
        ha="right",
        va="bottom" if progress.goal_is_below else "top",
        transform=axes.transAxes,
    )
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
    axes.yaxis.set_major_locator(MaxNLocator(nbins=5))
    axes.set_xlabel("env step", size=TICK_PT, color=INK, labelpad=1)
    style(axes, progress.title)


def style(axes: Axes, title: str) -> None:
    """Give a plot the look that all share."""
    axes.set_title(title, size=TITLE_PT, color=INK, pad=4)
    axes.tick_params(labelsize=TICK_PT, length=2.5, color=INK, labelcolor=INK, pad=2)
    for spine in axes.spines.values():
        spine.set(linewidth=0.6, color=INK)


def _limits(heights: FloatArray, progress: ProgressPlot) -> tuple[float, float]:
    low = min(float(heights.min()), progress.goal_mm, 0.0)
    high = max(float(heights.max()), progress.goal_mm, 0.0)
    margin = 0.15 * (high - low)
    return low - margin, high + margin


def _moved(vertices_m: FloatArray, offset_mm_deg: FloatArray) -> FloatArray:
    """Return a part shifted along x and y [mm] and turned about its own vertical axis [deg]; heights stay."""
    x_mm, y_mm, theta_deg = offset_mm_deg[:3]
    sine, cosine = np.sin(np.radians(theta_deg)), np.cos(np.radians(theta_deg))
    middle_m = vertices_m[:, :2].mean(axis=0)
    turned_m = (vertices_m[:, :2] - middle_m) @ np.array([[cosine, sine], [-sine, cosine]])
    return np.column_stack([turned_m + middle_m + 1e-3 * np.array([x_mm, y_mm]), vertices_m[:, 2]])


def _outline(vertices_m: FloatArray, triangles: NDArray[np.int64], plane: Plane, view: SectionView) -> Path:
    """Return all loops of a section as one path [mm]; holes turn the other way and stay empty."""
    axes = [index for index, _ in view.axes]
    loops = [1e3 * loop[:, axes] for loop in section_loops_m(vertices_m, triangles, plane)]
    if not loops:
        return Path(np.empty((0, 2)))
    return Path.make_compound_path(*(Path(np.vstack([loop, loop[:1]]), closed=True) for loop in loops))
