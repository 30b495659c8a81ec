"""What the cameras of a task see, and the colours of depth and marker motion."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import ceil, floor, log10
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from ..vision.camera import Sight
from ..vision.optics import HEIGHT_PX, WIDTH_PX
from ..vision.renderer import RenderMode
from .playback import EpisodePlayback, Moment
from .plots import INK, TICK_PT, style
from .projection import PictureCrop, widened
from .scene_view import cauchy_stress_pa, deformation_gradients, displacement_m, nodal_means, von_mises_pa

Picture = NDArray[np.uint8]
FloatArray = NDArray[np.float64]

_WIDTH_IN, _STRIP_HEIGHT_IN, _SHEET_HEIGHT_IN = 10.0, 3.0, 6.4
_DEPTHS = "viridis"
_UNKNOWN = "white"


class CameraStrip:
    """Draws colour and depth pictures side by side, all of an episode in one frame and on the same axes.

    Args:
        sights: what the rig saw in the episode.
        width_px: pixels across.
    """

    def __init__(self, sights: Sequence[Sight], *, width_px: int) -> None:
        self._frame = PictureCrop.around(sights)
        figure = Figure(figsize=(_WIDTH_IN, _STRIP_HEIGHT_IN), dpi=width_px / _WIDTH_IN, facecolor="white")
        colour, depth = figure.subplots(1, 2)
        figure.subplots_adjust(left=0.05, right=0.9, bottom=0.14, top=0.9, wspace=0.12)
        self._colour = _show(colour, sights[0].colours, self._frame, "camera, colour")
        self._depth = _show_depth(depth, sights[0], self._frame)
        self._figure = figure
        self._sight: Sight | None = None

    def picture(self, sight: Sight) -> Picture:
        """Return the picture of one of them, RGB of shape [height, width_px, 3]."""
        if sight is not self._sight:
            self._colour.set_data(sight.colours[self._frame.rows, self._frame.columns])
            self._depth.set_data(_shown_depth_mm(sight, self._frame))
            self._sight, self._picture = sight, _drawn(self._figure)
        return self._picture


def camera_sheet(sight: Sight, title: str, *, width_px: int) -> Picture:
    """Return colour, depth, infrared pair and point cloud in one picture, RGB of shape [height, width_px, 3].

    Args:
        sight: what the rig saw.
        title: names episode and env step.
        width_px: pixels across.
    """
    frame = PictureCrop.around([sight])
    figure = Figure(figsize=(_WIDTH_IN, _SHEET_HEIGHT_IN), dpi=width_px / _WIDTH_IN, facecolor="white")
    figure.text(0.02, 0.965, title, size=13, weight="bold", color=INK, va="center")
    grid = figure.add_gridspec(2, 3, left=0.05, right=0.93, bottom=0.07, top=0.89, wspace=0.3, hspace=0.28)
    _show(figure.add_subplot(grid[0, 0]), sight.colours, frame, "colour")
    _show_depth(figure.add_subplot(grid[0, 1]), sight, frame)
    for place, (name, picture) in enumerate((("left", sight.infrared.left), ("right", sight.infrared.right))):
        rows, columns = np.nonzero(picture)
        around = PictureCrop(
            rows=widened(rows, HEIGHT_PX),
            columns=widened(columns, WIDTH_PX),
            nearest_mm=frame.nearest_mm,
            farthest_mm=frame.farthest_mm,
        )
        _show(figure.add_subplot(grid[1, place]), picture, around, f"{name} infrared, brightened", cmap="gray")
    _show_cloud(figure.add_subplot(grid[:, 2], projection="3d"), sight, frame)
    return _drawn(figure)


def rendered_sheet(sight: Sight, rendered: Picture, title: str, *, mode: RenderMode, width_px: int) -> Picture:
    """Return the rig's colour picture beside one that SAPIEN rendered, RGB of shape [height, width_px, 3].

    Args:
        sight: what the rig saw.
        rendered: the same view by SAPIEN, RGB of shape [480, 640, 3].
        title: names episode and env step.
        mode: how it was rendered.
        width_px: pixels across.
    """
    frame = PictureCrop.around([sight])
    figure = Figure(figsize=(_WIDTH_IN, _STRIP_HEIGHT_IN + 0.4), dpi=width_px / _WIDTH_IN, facecolor="white")
    figure.text(0.02, 0.95, title, size=13, weight="bold", color=INK, va="center")
    ours, theirs = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.07, right=0.98, bottom=0.14, top=0.84, wspace=0.18)
    _show(ours, sight.colours, frame, "rgb_picture, as scored")
    _show(theirs, rendered, frame, f"SAPIEN {mode}, never scored")
    return _drawn(figure)


def _show(axes: Axes, picture: Picture, frame: PictureCrop, title: str, cmap: str | None = None) -> AxesImage:
    part = picture[frame.rows, frame.columns]
    image = axes.imshow(part, cmap=cmap, extent=_extent(frame), interpolation="nearest")
    _label(axes, title)
    return image


def _show_depth(axes: Axes, sight: Sight, frame: PictureCrop) -> AxesImage:
    colours, norm = _depth_colours(), Normalize(frame.nearest_mm, frame.farthest_mm)
    image = axes.imshow(
        _shown_depth_mm(sight, frame), cmap=colours, norm=norm, extent=_extent(frame), interpolation="nearest"
    )
    _label(axes, "depth, white where unknown")
    bar = axes.figure.colorbar(ScalarMappable(norm, colours), ax=axes, extend="both", pad=0.03, fraction=0.05)
    bar.ax.tick_params(labelsize=TICK_PT - 1, color=INK, labelcolor=INK)
    bar.set_label("mm", size=TICK_PT, color=INK, labelpad=2)
    return image


def _shown_depth_mm(sight: Sight, frame: PictureCrop) -> FloatArray:
    """Return the depth inside the frame [mm], masked where it is unknown."""
    masked: FloatArray = np.ma.masked_equal(1e3 * sight.depth_m[frame.rows, frame.columns], 0.0)
    return masked


def _show_cloud(axes: Any, sight: Sight, frame: PictureCrop) -> None:
    """Draw the points in the camera's frame, y and z turned so that up is up."""
    points_mm = 1e3 * sight.point_cloud_m[sight.depth_m > 0].astype(np.float64)
    x, y, z = points_mm.T
    axes.scatter(-x, z, y, c=z, s=1, cmap=_depth_colours(), vmin=frame.nearest_mm, vmax=frame.farthest_mm)
    axes.set_xlim(*_reach(-x))
    axes.set_ylim(frame.nearest_mm - 20.0, frame.farthest_mm + 20.0)
    axes.set_zlim(*_reach(y))
    axes.view_init(elev=18, azim=-70)
    axes.tick_params(labelsize=TICK_PT - 2)
    axes.set_xlabel("-x [mm]", size=TICK_PT)
    axes.set_ylabel("z, depth [mm]", size=TICK_PT)
    axes.set_zlabel("y [mm]", size=TICK_PT)
    axes.set_title("point cloud in the camera's frame", size=TICK_PT + 1, color=INK)


def _reach(values_mm: NDArray[np.float64]) -> tuple[float, float]:
    return (float(values_mm.min()), float(values_mm.max())) if len(values_mm) else (-100.0, 100.0)


def _label(axes: Axes, title: str) -> None:
    axes.set_xlabel("column [px]", size=TICK_PT, color=INK, labelpad=1)
    axes.set_ylabel("row [px]", size=TICK_PT, color=INK, labelpad=1)
    style(axes, title)


def _extent(frame: PictureCrop) -> tuple[float, float, float, float]:
    return frame.columns.start, frame.columns.stop, frame.rows.stop, frame.rows.start


def _depth_colours() -> Colormap:
    return colormaps[_DEPTHS].with_extremes(bad=_UNKNOWN)


def _drawn(figure: Figure) -> Picture:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()  # type: ignore[no-untyped-call]


_WITHIN = (0.01, 0.99)
_ROUNDING = 1e-6


class DrawnQuantity(StrEnum):
    """What gels are coloured by."""

    STRESS = "stress"  # von Mises stress
    DISPLACEMENT = "displacement"  # distance from the undeformed gel


@dataclass(frozen=True, kw_only=True)
class Colouring:
    """A quantity with its scale.

    Attributes:
        label: for the colour bar, with the unit.
        lowest: lower end of the scale, in that unit.
        highest: upper end.
        values: at the nodes of both gels for every moment, in that unit.
    """

    label: str
    lowest: float
    highest: float
    values: tuple[tuple[FloatArray, FloatArray], ...]


def colouring(playback: EpisodePlayback, quantity: DrawnQuantity) -> Colouring:
    """Return the quantity at all moments, on one scale that 98 % of the values are within."""
    values = tuple(
        (_values(playback, moment, 0, quantity), _values(playback, moment, 1, quantity)) for moment in playback.moments
    )
    label = "von Mises stress [kPa]" if quantity is DrawnQuantity.STRESS else "displacement [mm]"
    low, high = np.quantile(np.concatenate([gel for pair in values for gel in pair]), _WITHIN).tolist()
    lowest, highest = round_limits(low, high)
    return Colouring(label=label, lowest=lowest, highest=highest, values=values)


def round_limits(low: float, high: float) -> tuple[float, float]:
    """Return limits around a range that are multiples of a step: 1, 2 or 5 times a power of ten, about a tenth."""
    if not high > low:
        return low, low + 1.0
    power = 10.0 ** floor(log10((high - low) / 10.0))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if 10.0 * factor * power >= 0.999 * (high - low))
    return step * floor(low / step + _ROUNDING), step * ceil(high / step - _ROUNDING)


def _values(playback: EpisodePlayback, moment: Moment, gel: int, quantity: DrawnQuantity) -> FloatArray:
    """Return nodal values of a gel: stress in kPa (mean of the tetrahedra around a node) or displacement in mm."""
    mesh, nodes_m = playback.gel, moment.gel_nodes_m[gel]
    if quantity is DrawnQuantity.DISPLACEMENT:
        pose = moment.sensor_poses[gel]
        return 1e3 * displacement_m(mesh.rest_position_m, nodes_m, pose.rotation, pose.centre_m)
    stress_pa = cauchy_stress_pa(
        deformation_gradients(mesh.rest_position_m, nodes_m, mesh.tetrahedra),
        youngs_modulus_pa=playback.physics.youngs_modulus_pa,
        poisson_ratio=playback.physics.poisson_ratio,
    )
    return 1e-3 * nodal_means(von_mises_pa(stress_pa), mesh.rest_position_m, mesh.tetrahedra)
