"""Pictures of episodes with views, curves and texts, as `vitac show` writes them."""

from collections.abc import Iterator
from dataclasses import dataclass
from textwrap import shorten
from typing import Literal, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from ..scene.perspective import Beside, Perspective
from .camera_view import CameraStrip, DrawnQuantity, colouring
from .drawable import find_perspective
from .playback import TRUE_OFFSET, EpisodePlayback, Moment
from .plots import BELIEF_COLOUR, INK, QUIET, draw_progress, draw_section
from .scene_view import SceneImage, SceneView
from .sensor_view import SIDES, SensorPanels

FloatArray = NDArray[np.float64]

# The drawing's own size; a picture of another width is the same drawing with finer or coarser pixels.
_WIDTH_IN, _HEIGHT_IN = 10.0, 5.7
_SCENE_AREA = (0.005, 0.045, 0.485, 0.835)
_FONT_PT = 9.0
# Characters that have room beside the colour bar.
_LONGEST_LINE = 70
_END_COLOURS = {"success": "#1b7837"}
_FAILED_COLOUR, _RUNNING_COLOUR = "#b2182b", QUIET


@dataclass(frozen=True, kw_only=True)
class Caption:
    """What is said about an episode beside what is seen.

    Attributes:
        title: which episode.
        actions: where the actions came from.
    """

    title: str
    actions: str


def picture_size_px(width_px: int) -> tuple[int, int]:
    """Return the width and height of a picture [pixel]."""
    return width_px, round(width_px * _HEIGHT_IN / _WIDTH_IN)


def draw(
    playback: EpisodePlayback, caption: Caption, *, quantity: DrawnQuantity, width_px: int, moments: slice = slice(None)
) -> Iterator[NDArray[np.uint8]]:
    """Return the pictures of the chosen moments, each RGB of shape [height, width, 3].

    Args:
        playback: the episode.
        caption: what is said about it.
        quantity: what the gels are coloured by; the scale is the same in all pictures of the episode.
        width_px: pixels across.
        moments: which ones.

    Raises:
        NotDrawable: there is no perspective for the environment.
    """
    painter = Painter(playback, caption, quantity=quantity, width_px=width_px)
    for index in range(len(playback.moments))[moments]:
        yield painter.picture(index)


class _Anchor(NamedTuple):
    """Offset [points] and alignment of a name relative to its place."""

    right_pt: float
    up_pt: float
    horizontal: Literal["center", "right"]
    vertical: Literal["bottom", "center", "top"]


_ANCHORS = {
    Beside.ABOVE: _Anchor(0.0, 4.0, "center", "bottom"),
    Beside.BELOW: _Anchor(0.0, -4.0, "center", "top"),
    Beside.LEFT: _Anchor(-5.0, 0.0, "right", "center"),
}


class Painter:
    """Draws the moments of one playback, all on the same scales."""

    def __init__(self, playback: EpisodePlayback, caption: Caption, *, quantity: DrawnQuantity, width_px: int) -> None:
        self._playback = playback
        self._caption = caption
        self._perspective = find_perspective(playback.env_id)
        self._size_px = picture_size_px(width_px)
        self._colouring = colouring(playback, quantity)
        self._cmap = _colour_map(quantity)
        self._norm = Normalize(self._colouring.lowest, self._colouring.highest)
        self._view = SceneView(
            playback,
            self._perspective,
            width_px=round(self._size_px[0] * _SCENE_AREA[2]),
            height_px=round(self._size_px[1] * _SCENE_AREA[3]),
        )
        self._sensors = SensorPanels(playback)
        sights = [moment.sight for moment in playback.moments if moment.sight is not None]
        self._cameras = CameraStrip(sights, width_px=self._size_px[0]) if sights else None
        self._canvas = FigureCanvasAgg(self._empty_figure())

    def _empty_figure(self) -> Figure:
        """Return what all pictures share: axes, which take longer to make than to be drawn on, and the colour bar."""
        dpi = self._size_px[0] / _WIDTH_IN
        # The canvas rounds down to whole pixels.
        width_in, height_in = ((pixels + 0.5) / dpi for pixels in self._size_px)
        figure = Figure(figsize=(width_in, height_in), dpi=dpi, facecolor="white")
        self._scene = figure.add_axes(_SCENE_AREA)
        self._scene.set_axis_off()
        self._section = figure.add_axes((0.545, 0.595, 0.2, 0.245))
        self._progress = figure.add_axes((0.815, 0.595, 0.17, 0.245))
        self._panels = [figure.add_axes((0.53 + 0.235 * side.index, 0.17, 0.22, 0.29)) for side in SIDES]
        self._draw_colour_bar(figure)
        return figure

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Return the picture of one moment, RGB of shape [height, width, 3]."""
        self.figure(index)
        self._canvas.draw()  # type: ignore[no-untyped-call]
        scene = np.asarray(self._canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]
        sight = self._playback.moments[index].sight
        if sight is None or self._cameras is None:
            return scene.copy()
        return np.concatenate([scene, self._cameras.picture(sight)])

    def figure(self, index: int) -> Figure:
        """Return the drawing of one moment, until another one is asked for."""
        figure = self._canvas.figure
        moment, values = self._playback.moments[index], self._colouring.values[index]
        _wipe(figure, self._scene, self._section, self._progress, *self._panels)
        self._write_caption(figure, moment)
        self._draw_scene(moment, values)
        draw_section(self._section, self._perspective, self._playback, moment)
        draw_progress(self._progress, self._perspective.progress, self._playback, index)
        for side, axes in zip(SIDES, self._panels, strict=True):
            self._sensors.draw(axes, side, moment, values[side.index], cmap=self._cmap, norm=self._norm)
        return figure

    def _write_caption(self, figure: Figure, moment: Moment) -> None:
        outcome, colour = _outcome(moment, self._playback.moments[-1])
        figure.text(0.02, 0.955, self._caption.title, size=13, weight="bold", color=INK, va="center")
        figure.text(0.98, 0.955, outcome, size=11, weight="bold", color=colour, va="center", ha="right")
        left_mm, right_mm = (1e3 * moment.info["surface_diff_m"]).tolist()
        surfaces = f"surface_diff left {left_mm:.2f} mm, right {right_mm:.2f} mm"
        place = self._perspective.position(moment.info)
        height = 0.905
        if moment.believed is not None:  # two lines in the room of one
            height = 0.923
            believed = f"believed: {self._perspective.position({TRUE_OFFSET: moment.believed})}"
            figure.text(0.02, 0.895, believed, size=_FONT_PT, color=BELIEF_COLOUR, va="center")
        figure.text(0.02, height, f"{place}     {surfaces}", size=_FONT_PT, color=INK, va="center")
        actions = shorten(f"actions: {self._caption.actions}", _LONGEST_LINE, placeholder=" …")
        figure.text(0.02, 0.03, actions, size=_FONT_PT, color=QUIET, va="center")

    def _draw_scene(self, moment: Moment, values: tuple[FloatArray, FloatArray]) -> None:
        image = self._view.image(moment, values, lambda value: self._cmap(self._norm(value)))
        height, width = image.rgb.shape[:2]
        axes = self._scene
        axes.imshow(image.rgb, extent=(0, width, height, 0), interpolation="antialiased", aspect="auto")
        for lines, line_width, colour in (
            (image.element_lines, 0.35, (0.2, 0.1, 0.1, 0.45)),
            (image.faint_lines, 0.5, (*to_rgb(INK), 0.4)),
            (image.lines, 0.7, INK),
            (image.cut_lines, 1.1, INK),
        ):
            axes.add_collection(LineCollection(lines, linewidths=line_width, colors=[colour], capstyle="round"))
        axes.set_xlim(0, width)
        axes.set_ylim(height, 0)
        _label_parts(axes, image, self._perspective)

    def _draw_colour_bar(self, figure: Figure) -> None:
        bar = figure.colorbar(
            ScalarMappable(self._norm, self._cmap),
            cax=figure.add_axes((0.53, 0.085, 0.455, 0.022)),
            orientation="horizontal",
            extend="both",
            extendfrac=0.02,
        )
        bar.outline.set_linewidth(0.6)
        bar.ax.tick_params(labelsize=_FONT_PT - 1, length=2.5, color=INK, labelcolor=INK)
        bar.set_label(self._colouring.label, size=_FONT_PT, color=INK, labelpad=2)


def _wipe(figure: Figure, *plots: Axes) -> None:
    """Remove what was drawn of another moment; `clear` would also create the axes' own parts again."""
    drawn = [(axes.images, axes.collections, axes.lines, axes.patches, axes.texts) for axes in plots]
    for artist in [*figure.texts, *(artist for kinds in drawn for kind in kinds for artist in kind)]:
        artist.remove()


def _label_parts(axes: Axes, image: SceneImage, perspective: Perspective) -> None:
    _write(axes, perspective.held_name, image.held_middle, _Anchor(0.0, 0.0, "center", "center"))
    _write(axes, perspective.fixed_name, image.fixed_bottom, _ANCHORS[Beside.BELOW])
    for name, box, beside in zip(("left gel", "right gel"), image.gel_boxes, perspective.gel_labels, strict=True):
        (low_x, low_y), (_, high_y) = box
        middle_x, middle_y = 0.5 * (box[0] + box[1])
        places = {Beside.ABOVE: (middle_x, low_y), Beside.BELOW: (middle_x, high_y), Beside.LEFT: (low_x, middle_y)}
        _write(axes, name, np.array(places[beside]), _ANCHORS[beside])


def _write(axes: Axes, name: str, place: FloatArray, anchor: _Anchor) -> None:
    axes.annotate(
        name,
        (float(place[0]), float(place[1])),
        xytext=(anchor.right_pt, anchor.up_pt),
        textcoords="offset points",
        size=_FONT_PT,
        color=INK,
        ha=anchor.horizontal,
        va=anchor.vertical,
        path_effects=[withStroke(linewidth=2.5, foreground=(1.0, 1.0, 1.0, 0.75))],
    )


def _outcome(moment: Moment, last: Moment) -> tuple[str, str]:
    """Return the outcome in words, with its colour."""
    words = f"env step {moment.env_step} of {last.env_step}" if moment.env_step else "after the grasp"
    if moment.end_reason is None:
        return words, _RUNNING_COLOUR
    return f"{words}: {moment.end_reason.replace('_', ' ')}", _END_COLOURS.get(moment.end_reason, _FAILED_COLOUR)


def _colour_map(quantity: DrawnQuantity) -> Colormap:
    """Return colours from light to strong, without the darkest end, on which arrows could not be read."""
    name, part = ("YlOrRd", 0.75) if quantity is DrawnQuantity.STRESS else ("YlGnBu", 0.6)
    return LinearSegmentedColormap.from_list(f"light {name}", colormaps[name](np.linspace(0.0, part, 256)))
